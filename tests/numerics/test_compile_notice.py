"""Compiling for long is said once for each function, on a terminal, of calls of this package alone."""

import io
import os
import subprocess
import sys
import threading
import time
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import pytest

import jaxgrasp
from jaxgrasp.numerics import compiled_code
from jaxgrasp.numerics.compiled_code import COMPILED, LOWERED, TRACED, CompileNotice


class Stream(io.StringIO):
    def __init__(self, is_terminal: bool):
        super().__init__()
        self._is_terminal = is_terminal

    def isatty(self) -> bool:
        return self._is_terminal


def set_stderr(monkeypatch, stream):
    """Replace the stderr of this module alone: pytest sets that of the process for each test."""
    monkeypatch.setattr(compiled_code, "sys", SimpleNamespace(stderr=stream, _getframe=sys._getframe))
    return stream


@pytest.fixture
def terminal(monkeypatch) -> Stream:
    monkeypatch.delenv(compiled_code.VARIABLE, raising=False)
    return set_stderr(monkeypatch, Stream(True))


@pytest.fixture
def notice(terminal):
    """Yield a notice that appears without waiting."""
    notice = CompileNotice(0.0)
    notice.start()
    yield notice
    notice.stop()


def compile_anew(size: int) -> None:
    """Compile a plain call again: JAX forgets the small programs that it is made of."""
    jax.clear_caches()
    jaxgrasp.grasp_matrix(jnp.ones((size, 3)))


def test_a_call_that_compiles_says_so_once(notice, terminal):
    compile_anew(3)
    compile_anew(4)
    (line,) = terminal.getvalue().splitlines()
    assert line.startswith("jaxgrasp: the first call of grasp_matrix with arrays of these shapes compiles, for seconds")
    assert line.endswith(f"({compiled_code.VARIABLE}=0 turns such lines off)")


def test_each_function_that_compiles_is_named(notice, terminal):
    compile_anew(3)
    jaxgrasp.weight_wrench(jnp.ones(3), jnp.ones((3, 3)), jnp.ones(3))
    compile_anew(5)
    first, second = terminal.getvalue().splitlines()
    assert "call of grasp_matrix" in first and compiled_code.VARIABLE in first
    assert second == "jaxgrasp: the first call of weight_wrench with arrays of these shapes compiles, for seconds"


def test_use_cache_is_named_where_nothing_is_kept(notice, terminal, monkeypatch):
    monkeypatch.setattr(compiled_code, "_keeps_compiled_code", lambda: False)
    compile_anew(3)
    assert "; jaxgrasp.use_cache() keeps the compiled code" in terminal.getvalue()


def test_programs_of_the_users_own_are_left_alone(notice, terminal):
    jax.jit(lambda x: jnp.sin(x) + 0.12345)(jnp.ones(3)).block_until_ready()
    assert terminal.getvalue() == ""


def test_it_is_silent_where_it_is_turned_off(notice, terminal, monkeypatch):
    monkeypatch.setenv(compiled_code.VARIABLE, "0")
    compile_anew(3)
    assert terminal.getvalue() == ""


def test_it_is_silent_where_stderr_is_no_terminal(monkeypatch):
    monkeypatch.delenv(compiled_code.VARIABLE, raising=False)
    for stream in (Stream(False), None):
        set_stderr(monkeypatch, stream)
        notice = CompileNotice(0.0)
        notice.start()
        compile_anew(3)
        notice.stop()
        assert stream is None or stream.getvalue() == ""


def test_logging_is_as_it_was(notice, terminal):
    import logging

    names = ["", "jax", "jax._src.dispatch", "jaxgrasp"]
    before = [(logging.getLogger(name).level, list(logging.getLogger(name).handlers)) for name in names]
    compile_anew(3)
    assert [(logging.getLogger(name).level, list(logging.getLogger(name).handlers)) for name in names] == before


PHASES = {
    # Phases with their durations [s] as JAX reports them, after which XLA compiles on; patience is 2 s.
    "short": ([(TRACED, 0.5), (LOWERED, 0.5)], False),
    "traced for long": ([(TRACED, 2.5), (LOWERED, 0.5)], True),
    "an earlier program of the call": ([(TRACED, 0.5), (LOWERED, 0.5), (COMPILED, 1.5), (LOWERED, 0.1)], True),
    "inside one another": ([(TRACED, 0.4), (TRACED, 0.8), (TRACED, 1.2), (LOWERED, 0.1)], False),
    "after all has compiled": ([(TRACED, 0.5), (LOWERED, 0.5), (COMPILED, 5.0)], False),
}


@pytest.mark.parametrize("phases", PHASES)
def test_the_time_of_a_call_is_what_it_compiled_for(terminal, monkeypatch, phases):
    """Phases that are inside another count once; what was computed between does not count."""
    clock = 100.0
    monkeypatch.setattr(compiled_code.time, "perf_counter", lambda: clock)
    ours: dict = {"__name__": "jaxgrasp.made_up"}
    exec("def call(report): report()", ours)
    notice = CompileNotice()
    notice.start()
    events, is_said = PHASES[phases]

    def report() -> None:
        nonlocal clock
        for event, duration_s in events:
            # Each ends after the last; those inside another begin before it.
            clock += 0.01 if phases == "inside one another" else duration_s + 10.0
            notice._on_event(event, duration_s)

    try:
        ours["call"](report)
        assert ("the first call of call" in terminal.getvalue()) == is_said
    finally:
        cancel_timers()
        notice.stop()


def cancel_timers() -> None:
    for thread in threading.enumerate():
        if isinstance(thread, threading.Timer):
            thread.cancel()


def test_it_is_said_while_xla_still_compiles(terminal):
    ours: dict = {"__name__": "jaxgrasp.made_up"}
    exec("def call(report): report()", ours)
    notice = CompileNotice(0.05)
    notice.start()
    ours["call"](lambda: (notice._on_event(LOWERED, 0.01), time.sleep(0.3)))
    notice.stop()
    assert "the first call of call" in terminal.getvalue()


PROGRAM = """
import jax, numpy as np, jaxgrasp
jax.config.update("jax_enable_x64", True)
many = np.zeros((1000, 1, 1))
grasp = jaxgrasp.Grasp(many + np.eye(3), many - np.eye(3), np.ones(3), np.ones(3))
for _ in range(2):
    # Out of reach, so that all phases are compiled.
    jaxgrasp.constrained_optimum(grasp, many[:, 0] + np.arange(6.0))
"""


@pytest.mark.slow
@pytest.mark.parametrize("setting, n_lines", [({}, 1), ({compiled_code.VARIABLE: "0"}, 0)])
def test_a_program_at_a_terminal(setting, n_lines):
    environment = {name: value for name, value in os.environ.items() if "CACHE" not in name and name != "XLA_FLAGS"}
    environment.pop(compiled_code.VARIABLE, None)
    pytest.importorskip("pty", reason="a terminal of the test's own needs pseudo-terminals")
    ours, theirs = os.openpty()
    done = subprocess.run([sys.executable, "-c", PROGRAM], env=environment | setting, stderr=theirs)
    os.write(theirs, b"end")
    output = b""
    while not output.endswith(b"end"):
        output += os.read(ours, 10_000)
    for end in (ours, theirs):
        os.close(end)
    assert done.returncode == 0
    lines = output.decode().removesuffix("end").splitlines()
    assert len(lines) == n_lines and all("constrained_optimum" in line for line in lines), output
