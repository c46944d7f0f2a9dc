"""JAX as the command line uses it: 64 bits where asked for, compiled code kept.

These are global settings, so only a program that owns its process may make them: never a library.
"""

import platform
from datetime import UTC, datetime
from importlib.metadata import version

import jax

from jaxgrasp.cli.terminal import announce
from jaxgrasp.numerics.compiled_code import use_cache


def set_up_jax(dtype: str) -> None:
    """Must run before the first computation."""
    jax.config.update("jax_enable_x64", dtype == "float64")
    try:
        use_cache()
    except OSError as error:
        announce(f"compiled code is not kept: {error}")


def say_compiling(what: str, duration: str = "up to a minute") -> None:
    """What is compiled next, for how long where nothing of it is kept yet."""
    announce(f"compiling {what}, which takes {duration} the first time ...")


def provenance() -> dict[str, str]:
    """Where and when results were computed, and by which versions."""
    devices = jax.local_devices()
    return {
        "devices": f"{len(devices)} x {devices[0].device_kind}",
        "versions": versions(),
        "written": datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
    }


def versions() -> str:
    """By which programs results are computed."""
    return f"jaxgrasp {version('jaxgrasp')}, jax {jax.__version__}, Python {platform.python_version()}"
