"""JAX as the command line uses it: 64 bits where asked for, compiled code kept.

These are global settings, so only a program that owns its process may make them: never a library.
"""

import os
import platform
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path

import jax


def set_up_jax(dtype: str) -> None:
    """Must run before the first computation."""
    jax.config.update("jax_enable_x64", dtype == "float64")
    cache = os.environ.get("JAX_COMPILATION_CACHE_DIR") or str(_cache_home() / "jaxgrasp" / "jax")
    jax.config.update("jax_compilation_cache_dir", cache)
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.5)


def provenance() -> dict[str, str]:
    """Where and when results were computed, and by which versions."""
    devices = jax.local_devices()
    return {
        "devices": f"{len(devices)} x {devices[0].device_kind}",
        "versions": f"jaxgrasp {version('jaxgrasp')}, jax {jax.__version__}, Python {platform.python_version()}",
        "written": datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
    }


def _cache_home() -> Path:
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
