"""Saving and restoring everything that training changes, as tensors named by their path in the state."""

from pathlib import Path
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from cellpilot.errors import InputError
from cellpilot.learn.networks import QNetwork
from cellpilot.policies.learned import PolicyParameters
from cellpilot.storage import load_tensors, save_tensors

STATE_FORMAT = "cellpilot-state-2"
STATE_HEADER = {"fingerprint", "seed", "train_wall_s"}
State = TypeVar("State")


def save_state(path: Path, state: Any, history: dict[str, np.ndarray], about: dict[str, Any]) -> None:
    """Write state, history and description atomically: an interrupted save leaves the previous file."""
    tensors = {f"state.{name}": np.asarray(leaf) for name, leaf in named_leaves(state).items()}
    tensors |= {f"history.{name}": np.ascontiguousarray(column) for name, column in history.items()}
    save_tensors(path, tensors, STATE_FORMAT, about)


def load_state(path: Path, template: State, identity: dict[str, Any]) -> tuple[State, dict[str, np.ndarray], dict[str, Any]]:
    """The state with the structure of `template`, the history and the description (fingerprint, seed, train_wall_s).

    `InputError` for a damaged file, one whose description differs from `identity`, or whose tensors do not fit.
    """
    tensors, about = load_tensors(path, STATE_FORMAT, STATE_HEADER, "delete it to train from the start")
    try:
        about = {"fingerprint": about["fingerprint"], "seed": about["seed"], "train_wall_s": float(about["train_wall_s"])}
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"{path}: the description is damaged ({error!r}); delete it to train from the start") from error
    if about | identity != about:
        raise InputError(f"{path}: a checkpoint of another map, task, learner or seed; delete it to train from the start")
    expected = named_leaves(template)
    for name, leaf in expected.items():
        found = tensors.get(f"state.{name}")
        if found is None or found.shape != leaf.shape or found.dtype != leaf.dtype:
            what = "missing" if found is None else f"{found.dtype}{list(found.shape)}"
            raise InputError(f"{path}: {name} is {what}, expected {leaf.dtype}{list(leaf.shape)}: a checkpoint of other settings")
    # A learner in plain Python has arrays of NumPy, in double precision too.
    like = lambda name: np.asarray if isinstance(expected[name], np.ndarray) else jnp.asarray
    leaves = [like(name)(tensors[f"state.{name}"]) for name in expected]
    state = jax.tree.unflatten(jax.tree.structure(template), leaves)
    history = {name.removeprefix("history."): value for name, value in tensors.items() if name.startswith("history.")}
    return state, history, about


def named_leaves(tree: Any) -> dict[str, Any]:
    """Array leaves by their dotted path, in the order of `jax.tree.leaves`."""
    return {
        ".".join(str(getattr(key, "name", getattr(key, "idx", getattr(key, "key", key)))) for key in path): leaf
        for path, leaf in jax.tree_util.tree_leaves_with_path(tree)
    }


def policy_parameters(
    network: QNetwork, architecture: str, sides: tuple[int, int, int], about: dict[str, Any]
) -> PolicyParameters:
    """The network as plain NumPy weights that fly without JAX."""
    tensors = {name: np.asarray(leaf) for name, leaf in named_leaves(eqx.filter(network, eqx.is_array)).items()}
    return PolicyParameters(tensors, architecture, sides, about)
