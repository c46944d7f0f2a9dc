"""Programs that use the C++ kernel: fuzzed input under sanitizers, and the example of a controller."""

import subprocess
from pathlib import Path

import pytest

from benchmarks.kernel_calls import FAST, compile_files
from jaxgrasp.kernel import include_folder

INTERFACE = include_folder() / "one_grasp_c.cpp"
FUZZ = Path(__file__).with_name("fuzz.cpp")
CONTROLLER = Path(__file__).parents[2] / "benchmarks" / "controller.cpp"
SANITIZERS = ("-fsanitize=address,undefined", "-fno-sanitize-recover=all")


def _fuzz(folder: Path, options: tuple[str, ...], count: int) -> list[int]:
    """Return the number of each verdict among ``count`` fuzzed problems; fails where an answer is refuted."""
    program = compile_files([FUZZ, INTERFACE], folder / "fuzz", options)
    result = subprocess.run([program, str(count), "1"], capture_output=True, text=True)
    assert result.returncode == 0, result.stdout + result.stderr[-2000:]
    counts = [int(number) for number in result.stdout.split()]
    assert sum(counts) == count
    return counts


def _check_variety(counts: list[int]) -> None:
    """Check that the problems reach every verdict but OUTSIDE_CONES, which is none of an optimum."""
    assert counts[2] == 0
    assert all(number > 0 for code, number in enumerate(counts) if code != 2)


@pytest.mark.slow
def test_fuzzed_input_under_sanitizers(compiled_by_gcc, tmp_path):
    _check_variety(_fuzz(tmp_path, ("-O1", "-g", "-march=native", *SANITIZERS), 1_000_000))


def test_fuzzed_input(compiled_by_gcc, tmp_path):
    _check_variety(_fuzz(tmp_path, ("-O0",), 20_000))


@pytest.mark.slow
def test_controller_solves_a_thousand_times_a_second(compiled_by_gcc, tmp_path):
    program = compile_files([CONTROLLER, INTERFACE], tmp_path / "controller", FAST)
    result = subprocess.run([program, "3000"], capture_output=True, text=True)
    assert result.returncode == 0, result.stdout + result.stderr
    assert "3000 ticks" in result.stdout
