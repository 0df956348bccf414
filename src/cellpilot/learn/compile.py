"""Compilation ahead of time, with the compiler's options for this kind of program."""

from collections.abc import Callable
from functools import wraps
from typing import Any, ParamSpec, TypeVar

import jax

Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")

CPU_OPTIONS = {"xla_cpu_prefer_vector_width": 512}
"""As wide as the processor has: loops between the products get 1 us of 15 faster; the default is 256. docs/speed.md"""


def compile_ahead(function: Any, *arguments: Any, **settings: Any) -> Any:
    """A jitted function compiled for these arguments; `settings` are its static arguments, bound by this call."""
    options = CPU_OPTIONS if jax.default_backend() == "cpu" else None
    return function.lower(*arguments, **settings).compile(compiler_options=options)


def single_precision(function: Callable[Arguments, Result]) -> Callable[Arguments, Result]:
    """The function in float32 and int32 whatever `JAX_ENABLE_X64` says: equal settings are to give equal numbers."""

    @wraps(function)
    def inner(*arguments: Arguments.args, **options: Arguments.kwargs) -> Result:
        with jax.enable_x64(False):
            return function(*arguments, **options)

    return inner


def forget_programs() -> None:
    """Let go of all compiled programs: every training of a study has its own, which would stay in memory until its end."""
    jax.clear_caches()
