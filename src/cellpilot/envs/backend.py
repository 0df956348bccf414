"""Whether JAX can compute here, asked before anything is put on a device."""

import os

import jax

from cellpilot.errors import InputError


def check_backend() -> None:
    """`InputError` in one line where JAX finds no device, or is told not to compile."""
    try:
        jax.devices()
    except (RuntimeError, AssertionError) as error:
        asked = os.environ.get("JAX_PLATFORMS", "")
        reason = " ".join(str(error).split())[:160] or "no such device"
        raise InputError(f"JAX finds no device for JAX_PLATFORMS={asked} ({reason}): unset it, or set it to cpu") from None
    if jax.config.jax_disable_jit:  # type: ignore[attr-defined]
        raise InputError("JAX_DISABLE_JIT is set, but training compiles its programs: unset it")
