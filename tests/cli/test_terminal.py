"""Output of every command at a terminal: notes on compiling, help without Python's terms, any encoding."""

import io
import os
import subprocess
import sys
import time

import jax
import jax.numpy as jnp
import pytest

from jaxgrasp.cli.machine import TOLD_EVERY, compiling
from jaxgrasp.cli.main import main


class Screen(io.StringIO):
    """Says that it is a terminal."""

    def isatty(self) -> bool:
        return True


def compile_something() -> None:
    with compiling("a test"):

        @jax.jit
        def a_function_of_its_own(x):
            return jnp.sin(x) + time.perf_counter()

        a_function_of_its_own(jnp.ones(3))
        time.sleep(3 * TOLD_EVERY)


def test_a_screen_says_how_many_programs_are_compiled_and_which(monkeypatch):
    screen = Screen()
    monkeypatch.setattr(sys, "stderr", screen)
    compile_something()
    output = screen.getvalue()
    assert "compiling a test: " in output and "programs in 0 s, now a_function_of_its_own" in output
    assert output.rstrip(" ").endswith("\r"), "nothing of it is left"


def test_a_file_is_told_nothing_of_it(capfd):
    compile_something()
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize(
    "command", [["evaluate"], ["grip"], ["experiment", "run"], ["glove", "run"], ["import", "bodex"]]
)
def test_help_names_what_is_to_be_given(capsys, command):
    with pytest.raises(SystemExit):
        main([*command, "--help"])
    output = capsys.readouterr().out
    assert "None}" not in output and ("PATH" in output or "STR" in output)


def test_a_terminal_without_letters_shows_their_codes(folder):
    (folder / "plan.toml").write_text('[stimulus]\nkind = "torque"\n[session]\nreferences = [0.05]')
    done = subprocess.run(
        [sys.executable, "-m", "jaxgrasp.cli.main", "experiment", "plan", "plan.toml"],
        capture_output=True,
        env=os.environ | {"PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0", "LC_ALL": "C"},
    )
    assert done.returncode == 0 and rb"references 0.05 N\xb7m" in done.stdout, done.stderr
