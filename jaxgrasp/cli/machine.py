"""JAX as the command line uses it: 64 bits where asked for, compiled code kept.

These are global settings, so only a program that owns its process may make them: never a library.

Sampled times of the commands that simulate a motion.
"""

import contextlib
import os
import platform
import sys
import threading
import time
from collections.abc import Iterator
from datetime import UTC, datetime
from importlib.metadata import version

import jax
import numpy as np
from tqdm import tqdm

from jaxgrasp.cli.terminal import announce
from jaxgrasp.numerics import compiled_code
from jaxgrasp.numerics.compiled_code import compile_all_quickly, use_cache

TOLD_EVERY = 0.2
"""Time between two words on what is compiled [s]."""


def set_up_jax(dtype: str, *, quickly: bool = False) -> None:
    """Set precision and cache of compiled code; must run before the first computation.

    Args:
        dtype: float64 or float32.
        quickly: whether to compile quickly, to slower code, as suits programs that do not run often.
    """
    # `compiling` says it, in a bar; processes that this one starts are quiet too.
    os.environ.setdefault(compiled_code.VARIABLE, "0")
    if quickly:
        compile_all_quickly()
    jax.config.update("jax_enable_x64", dtype == "float64")
    try:
        use_cache()
    except OSError as error:
        announce(f"compiled code is not cached: {error}")


@contextlib.contextmanager
def compiling(subject: str) -> Iterator[None]:
    """Show a bar on a terminal's stderr meanwhile: programs compiled, the name of the current program, and seconds."""
    if not sys.stderr.isatty():
        yield
        return
    started, over, done, current_program = time.perf_counter(), threading.Event(), 0, ""

    def heard(event: str, duration_secs: float, **of: str | int) -> None:
        nonlocal done, current_program
        done += event == compiled_code.COMPILED
        if event == compiled_code.LOWERED:
            current_program = f", now {str(of.get('fun_name', '')).removeprefix('jit(').removesuffix(')')}"

    def tell() -> None:
        while not over.wait(TOLD_EVERY):
            bar.set_description_str(
                f"compiling {subject}: {done} programs in {time.perf_counter() - started:.0f} s"
                f"{current_program if done else ''}"
            )

    jax.monitoring.register_event_duration_secs_listener(heard)
    with tqdm(bar_format="{desc}", file=sys.stderr, leave=False) as bar:
        teller = threading.Thread(target=tell, daemon=True)
        teller.start()
        try:
            yield
        finally:
            over.set()
            teller.join()
            jax.monitoring.unregister_event_duration_listener(heard)


def provenance() -> dict[str, str]:
    """Return devices, versions and date of the results, as text by name."""
    devices = jax.local_devices()
    return {
        "devices": f"{len(devices)} x {devices[0].device_kind}",
        "versions": versions(),
        "written": datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
    }


def versions() -> str:
    """Return the versions of jaxgrasp, JAX and Python, as a line."""
    return f"jaxgrasp {version('jaxgrasp')}, jax {jax.__version__}, Python {platform.python_version()}"


def sampled_times(seconds: float, step: float) -> np.ndarray:
    """Return times from 0 to ``seconds``, about ``step`` apart [s]; raise ValueError for a step above ``seconds``."""
    if step > seconds:
        raise ValueError(f"step is {step}: expected at most seconds, {seconds}")
    return np.linspace(0, seconds, max(2, round(seconds / step) + 1))
