"""Tests run in 64-bit mode, keep compiled code between runs, and check array shapes at every call."""

import os
import subprocess
from collections import defaultdict
from datetime import date
from pathlib import Path

import jax
import jaxtyping
import pytest
from jax.experimental.compilation_cache import compilation_cache

from tests.light_checks import check_lightly

check_lightly()
# Most of the suite's time is compiling. Unless XLA_FLAGS are given, it is done in a quarter of the time, for slower
# code: verdicts do not hang on it, as `python -m benchmarks.compile` counts. A flag that XLA does not know ends the
# process, and others than these versions may not know the second.
_FAST = "--xla_backend_optimization_level=0"
if jax.__version_info__ < (0, 11):
    _FAST += " --xla_cpu_use_fusion_emitters=false"
os.environ.setdefault("XLA_FLAGS", _FAST)
# The JAX solver is the reference; tests/kernel holds the compiled kernel to it.
os.environ.setdefault("JAXGRASP_KERNEL", "0")
jax.config.update("jax_enable_x64", True)
# The cache is keyed by the code itself, so it cannot go stale.
_CACHE = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "jaxgrasp" / "jax"
_KEEPS = {
    "jax_compilation_cache_dir": os.environ.get("JAX_COMPILATION_CACHE_DIR") or str(_CACHE),
    # The small programs too: there are thousands of them, many of them in several files.
    "jax_persistent_cache_min_compile_time_secs": 0.0,
}


def _keep_compiled_code() -> None:
    for name, value in _KEEPS.items():
        if getattr(jax.config, name) != value:
            jax.config.update(name, value)
            compilation_cache.reset_cache()


_keep_compiled_code()


@pytest.fixture
def folder(tmp_path, monkeypatch) -> Path:
    """Return an empty folder that is the working directory too, so that nothing else is written to."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def unchecked(monkeypatch) -> None:
    """Switch off the checks of array shapes, as in a user's program, which has only our own messages."""
    monkeypatch.setattr(jaxtyping.config, "jaxtyping_disable", True)


@pytest.fixture(autouse=True)
def keep_compiled_code():
    """Point the cache of compiled code back to the tests' own folder after a command ran inside this process."""
    yield
    _keep_compiled_code()


@pytest.fixture(autouse=True)
def trace_anew(monkeypatch):
    """Read no program that an earlier test kept by a command's ``use_cache``: a test may look at what is traced."""
    from jaxgrasp.numerics import kept_programs

    monkeypatch.setattr(kept_programs, "program_folder", lambda: None)


@pytest.fixture(autouse=True, scope="module")
def forget_compiled_code():
    """Clear the compiled functions after each module: they hold memory maps, of which a process may have some 65,000.

    Keeping them for as long as there is room takes twice the memory and saves a twentieth of the time.
    """
    yield
    jax.clear_caches()
    from jaxgrasp.numerics.kept_programs import clear_programs

    clear_programs()


PARTS = 10
"""The long tests take turns, by the day of the commit: each time one law in so many, and of a law that is marked
``repeats``, which goes through many sizes or kinds, one case in so many. All of them run with ``JAXGRASP_TEST_ALL=1``,
and those that are named one by one; what is marked ``always`` runs each time."""


def _part(config: pytest.Config) -> int | None:
    """Return which part of the long tests runs, None for all of them."""
    if os.environ.get("JAXGRASP_TEST_ALL") or any("::" in arg for arg in config.args):
        return None
    try:
        changed_files = subprocess.run(
            ["git", "log", "-1", "--format=%cs"], cwd=Path(__file__).parent, capture_output=True, text=True, check=True
        )
        day = date.fromisoformat(changed_files.stdout.strip())
    except (OSError, ValueError, subprocess.CalledProcessError):
        day = date.today()
    return day.toordinal() % PARTS


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    if config.option.markexpr.startswith("slow"):
        part = _part(config)
        which = "all" if part is None else f"part {part + 1} of {PARTS}; all with JAXGRASP_TEST_ALL=1"
        terminalreporter.write_line(f"long tests: {which}")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    part = _part(config)
    if part is None:
        return
    rounds: defaultdict[tuple | None, dict] = defaultdict(dict)
    selected, left_out = [], []
    for item in items:
        law = (item.path, getattr(item, "originalname", item.name))
        # Laws take turns among one another, the cases of a law that repeats among themselves.
        among, key = (law, item.nodeid) if item.get_closest_marker("repeats") else (None, law)
        takes_turns = item.get_closest_marker("slow") and not item.get_closest_marker("always")
        waits = takes_turns and rounds[among].setdefault(key, len(rounds[among])) % PARTS != part
        (left_out if waits else selected).append(item)
    config.hook.pytest_deselected(items=left_out)
    items[:] = selected
