"""Compiled code that is kept serves the next process, and nothing changes until it is asked for."""

import os
import subprocess
import sys
from importlib.metadata import entry_points
from pathlib import Path

import jax
import pytest

from jaxgrasp.numerics import compiled_code

PROGRAM = """
import jax, jaxgrasp
assert jax.config.jax_compilation_cache_dir is None
jax.jit(lambda x: x + 1)(1.0)  # the first compilation, before there is a folder
misses = []
jax.monitoring.register_event_listener(lambda name, **_: misses.append(name.endswith("/cache_misses")))
print(jaxgrasp.use_cache({folder}))
grasp = jaxgrasp.Grasp(jax.numpy.eye(3), -jax.numpy.eye(3), jax.numpy.ones(3), jax.numpy.ones(3))
jaxgrasp.closed_form(grasp, jax.numpy.zeros(6))
print(any(misses))
"""


def run(folder: str = "", **environment: str) -> list[str]:
    environment = {name: value for name, value in os.environ.items() if "CACHE" not in name} | environment
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM.format(folder=folder)], env=environment, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


def test_the_next_process_finds_what_was_kept(tmp_path):
    cache = tmp_path / "kept"
    assert run(repr(str(cache))) == [str(cache), "True"]
    assert any(cache.iterdir())
    assert run(repr(str(cache))) == [str(cache), "False"]


@pytest.mark.slow
@pytest.mark.parametrize("name, parts", [("JAX_COMPILATION_CACHE_DIR", ()), ("XDG_CACHE_HOME", ("jaxgrasp", "jax"))])
def test_the_folder_is_the_command_lines_own(tmp_path, name, parts):
    if name == "JAX_COMPILATION_CACHE_DIR":
        # JAX reads this one itself.
        environment = {**os.environ, name: str(tmp_path)}
        code = "import jaxgrasp; print(jaxgrasp.use_cache())"
        output = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True).stdout
    else:
        output = run(**{name: str(tmp_path)})[0]
    assert Path(output.strip()) == tmp_path.joinpath(*parts)


def test_a_folder_that_cannot_be_is_an_error(tmp_path):
    from jaxgrasp import use_cache

    (tmp_path / "file").touch()
    with pytest.raises(OSError, match="file"):
        use_cache(tmp_path / "file" / "below")


def test_commands_run_where_nothing_can_be_kept(tmp_path):
    (tmp_path / "file").touch()
    done = subprocess.run(
        [sys.executable, "-c", "from jaxgrasp.cli.machine import set_up_jax; set_up_jax('float64')"],
        env=os.environ | {"JAX_COMPILATION_CACHE_DIR": str(tmp_path / "file" / "below")},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0 and done.stderr.startswith("compiled code is not cached: ")


QUICKLY = """
import os, jax
from jaxgrasp.numerics.compiled_code import compile_all_quickly
compile_all_quickly()
print(os.environ["XLA_FLAGS"])
print(jax.jit(lambda x: jax.numpy.sin(x) + 1)(1.0))
"""


@pytest.mark.skipif(bool(entry_points(group="jax_plugins")), reason="there may be other processors")
@pytest.mark.parametrize("flags", [None, "--xla_backend_optimization_level=1"])
def test_a_process_compiles_quickly_unless_the_user_says_how(flags):
    """XLA ends a process whose options it does not know."""
    environment = {name: value for name, value in os.environ.items() if name != "XLA_FLAGS"}
    environment |= {} if flags is None else {"XLA_FLAGS": flags}
    done = subprocess.run([sys.executable, "-c", QUICKLY], env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    options, value = done.stdout.splitlines()
    assert options == flags or (flags is None and "--xla_backend_optimization_level=0" in options.split())
    assert abs(float(value) - 1.8414709848) < 1e-6


@pytest.fixture
def newer_jax(monkeypatch):
    """Pretend a version of JAX that is newer than any tested one."""
    monkeypatch.setattr(jax, "__version_info__", compiled_code.UNMEASURED_FROM)
    monkeypatch.delenv(compiled_code.WARNS, raising=False)
    compiled_code.is_known_xla.cache_clear()
    yield
    compiled_code.is_known_xla.cache_clear()


@pytest.mark.skipif(jax.default_backend() != "cpu", reason="said on a processor alone")
def test_an_untested_version_of_jax_is_said_once(newer_jax):
    with pytest.warns(RuntimeWarning, match=f"newer than .*{compiled_code.WARNS}=0") as warned:
        assert not compiled_code.is_known_xla()
        assert not compiled_code.is_known_xla()
    assert len(warned) == 1


def test_the_warning_of_an_untested_version_can_be_turned_off(newer_jax, monkeypatch):
    monkeypatch.setenv(compiled_code.WARNS, "0")
    assert not compiled_code.is_known_xla()  # a warning would be an error here


def test_options_that_the_user_gives_in_xla_flags_stay(monkeypatch):
    """An option of a program would override what the user says for the whole process."""
    name = next(iter(compiled_code.COMPILED_ONCE))
    monkeypatch.setenv("XLA_FLAGS", f"--{name}=3")
    assert name not in (compiled_code.compile_quickly_options() or {})
    monkeypatch.setenv("XLA_FLAGS", "")
    assert jax.default_backend() != "cpu" or compiled_code.compile_quickly_options() == compiled_code.COMPILED_ONCE


MARGINS = """
import numpy as np
from jaxgrasp.batch.qualities import margins
from jaxgrasp.batch.contact_sets import ContactSets
import jax
jax.config.update("jax_enable_x64", True)
normals = np.tile([[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0]], (8, 1))
forces = np.tile([[-5.0, 0.0, 1.0], [5.0, 0.0, 1.0]], (8, 1))
friction = np.linspace(0.1, 0.9, 16)
sets = ContactSets(-normals, normals, friction, friction, np.arange(17), np.zeros((16, 1, 6)))
margin, _ = margins(sets, forces[:, None], None)
assert np.abs(margin[:, 0] - (np.arctan(friction) - np.arctan2(1.0, 5.0))).max() < 1e-14, np.degrees(margin[:, 0])
"""


def test_programs_of_plain_calls_give_the_angles_that_numpy_gives():
    """Compile as users do: with vectors of 512 bits, XLA gave wrong arctangents where the processor has them."""
    environment = {name: value for name, value in os.environ.items() if name != "XLA_FLAGS"}
    done = subprocess.run([sys.executable, "-c", MARGINS], env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
