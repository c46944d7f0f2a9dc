"""Compiled code: where it is kept between processes, and how it is made."""

import os
from collections.abc import Callable
from contextvars import ContextVar
from functools import cache, wraps
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

import jax
from jax.experimental.compilation_cache import compilation_cache

LEAST_SECONDS = 0.1
"""Programs that compile faster than this are not worth a file."""
FUSED_BY_LOOPS = {"xla_cpu_use_fusion_emitters": False}
NOT_OPTIMIZED = {"xla_backend_optimization_level": 0}
"""Options of XLA."""
_traces_for_processor: ContextVar[bool] = ContextVar("traces_for_processor", default=False)


def use_cache(folder: str | os.PathLike | None = None) -> Path:
    """Keep compiled code in a folder, for this process and the next ones; the command line does so by itself.

    What is kept goes by the program itself, the versions and the machine, so it never has to be thrown away. This
    changes settings of JAX for the whole process, as it says, and only where it is called.

    Args:
        folder: made where it is not there yet; where not given, ``JAX_COMPILATION_CACHE_DIR`` if that is set, or
            ``jaxgrasp/jax`` in the user's folder for caches, the command line's own.

    Returns:
        The folder.

    Raises:
        OSError: where there can be no such folder.
    """
    path = Path(folder or os.environ.get("JAX_COMPILATION_CACHE_DIR") or _home() / "jaxgrasp" / "jax")
    path.mkdir(parents=True, exist_ok=True)
    jax.config.update("jax_compilation_cache_dir", str(path))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", LEAST_SECONDS)
    # JAX looks for its folder at the first compilation, which may have been.
    compilation_cache.reset_cache()
    return path


def _home() -> Path:
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")


def compile_all_quickly() -> None:
    """Have this process compile all of its programs quickly, to code several times as slow.

    It is said in ``XLA_FLAGS``, which XLA reads before its first program; what the user says there stays. Where JAX has
    plugins, which bring other processors than these, nothing is changed.
    """
    if "XLA_FLAGS" not in os.environ and not entry_points(group="jax_plugins"):
        options = (FUSED_BY_LOOPS if _is_known_version() else {}) | NOT_OPTIMIZED
        os.environ["XLA_FLAGS"] = " ".join(f"--{name}={str(value).lower()}" for name, value in options.items())


def _is_known_version() -> bool:
    return (0, 10) <= jax.__version_info__ < (0, 11)


@cache
def is_known_xla() -> bool:
    """Whether programs are compiled for the processor, by a version whose ways of doing so are known here."""
    return _is_known_version() and jax.default_backend() == "cpu"


def _compile_options() -> dict[str, str | bool] | None:
    """Options with which XLA compiles programs for the processor in two thirds of the time, to the same speed.

    Known of some versions alone; another may not know the option, and would refuse it.
    """
    return {**FUSED_BY_LOOPS} if is_known_xla() else None


def compile_quickly_options() -> dict[str, str | bool | int] | None:
    """Options for programs that run once or a few times: compiled in half the time, to code several times as slow."""
    if jax.default_backend() != "cpu":
        return None
    return (_compile_options() or {}) | NOT_OPTIMIZED


def jit_here(function: Callable, **options: Any) -> jax.stages.Wrapped:
    """``jax.jit`` of a program that runs where JAX computes by default, compiled in less time to the same speed.

    Where that is the processor, what differs between platforms is traced for it alone, in half the time. A user's
    own program may yet be lowered for another.
    """
    return jax.jit(traced_for_here(function), compiler_options=_compile_options(), **options)


def traced_for_here(function: Callable) -> Callable[..., Any]:
    """The function, which may be traced for the platform alone where JAX computes by default."""

    # Always another function than the one given, whose trace JAX would keep for programs of all platforms.
    @wraps(function)
    def traced(*args: Any, **kwargs: Any) -> Any:
        token = _traces_for_processor.set(jax.default_backend() == "cpu")
        try:
            return function(*args, **kwargs)
        finally:
            _traces_for_processor.reset(token)

    return traced


def traces_for_processor() -> bool:
    """Whether what is traced now is for the processor alone."""
    return _traces_for_processor.get()
