import beartype.roar
import jax
import jax.numpy as jnp
import jaxtyping
import pytest

from cellpilot.learn.losses import squared_td_error


def test_annotations_of_compiled_code_are_checked() -> None:
    """Otherwise the import hook of `conftest.py` came too late and every shape annotation is decoration."""
    with pytest.raises((jaxtyping.TypeCheckError, beartype.roar.BeartypeException)):
        squared_td_error(jnp.zeros((3, 4)), jnp.zeros(2, jnp.int32), jnp.zeros(3))
    jax.block_until_ready(squared_td_error(jnp.zeros((3, 4)), jnp.zeros(3, jnp.int32), jnp.zeros(3)))
