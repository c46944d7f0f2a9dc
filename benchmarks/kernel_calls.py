"""The C++ kernel, compiled by g++ and called by ctypes on many problems at once; for tests and benchmarks."""

import ctypes
import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from jaxgrasp.kernel import include_folder
from jaxgrasp.testing.references import Problems

FAST = ("-O3", "-march=native", "-fno-math-errno")
"""Options that the header recommends."""
HERE = Path(__file__).parent
ARRAYS = (
    "points",
    "normals",
    "friction",
    "squeeze",
    "wrench",
    "weights",
    "present",
    "torsion",
    "normal_min",
    "normal_max",
)
"""Fields of ``jaxgrasp_problem`` after the number of contacts, in their order."""
ANSWER = np.dtype(
    [
        ("multiplier", "f8", 6),
        ("certificate", "f8", 6),
        ("residual", "f8"),
        ("objective", "f8"),
        ("force_bound", "f8"),
        ("verdict", "i4"),
        ("route", "i4"),
        ("steps", "i4"),
        ("rank", "i4"),
    ]
)
"""The structure ``jaxgrasp_answer``."""


class CProblem(ctypes.Structure):
    """The structure ``jaxgrasp_problem``."""

    _fields_ = [("n_contacts", ctypes.c_int), *((name, ctypes.c_void_p) for name in ARRAYS)]


class Answers(NamedTuple):
    """Answers of ``B`` problems of ``n`` contacts."""

    forces: np.ndarray
    """``(B, n, 3)``."""
    moments: np.ndarray
    """``(B, n)``."""
    answer: np.ndarray
    """``(B,)`` of ``ANSWER``."""

    @property
    def verdict(self) -> np.ndarray:
        """Codes of the verdicts ``(B,)``."""
        return self.answer["verdict"]


def arrays_of(problem: Problems) -> dict[str, np.ndarray]:
    """Return the arrays of test problems by the names of ``ARRAYS``."""
    return {name: getattr(problem, name) for name in ARRAYS[:5]}


def has_compiler() -> bool:
    """Return whether g++ is installed."""
    return shutil.which("g++") is not None


def compile_files(sources: Sequence[Path], out: Path, options: Sequence[str]) -> Path:
    """Compile C++ files into ``out`` by g++ with the kernel's headers; raise RuntimeError with its messages."""
    files = [str(source) for source in sources]
    command = ["g++", "-std=c++17", "-Wall", "-Wextra", *options, f"-I{include_folder()}", *files, "-o", str(out)]
    result = subprocess.run(command, capture_output=True, text=True)
    if result.returncode or result.stderr:
        raise RuntimeError(f"{' '.join(command)}:\n{result.stderr}")
    return out


class Kernel:
    """The compiled kernel."""

    def __init__(self, folder: Path, options: Sequence[str] = FAST):
        sources = [include_folder() / "one_grasp_c.cpp", HERE / "many_grasps.cpp"]
        path = compile_files(sources, folder / "many_grasps.so", [*options, "-shared", "-fPIC"])
        self._library = ctypes.CDLL(str(path))

    def solve(self, **arrays: np.ndarray) -> Answers:
        """Solve problems ``(B, n, ...)``, whose arrays have the names of ``ARRAYS``; weights and below are optional."""
        data = {name: np.ascontiguousarray(array, float) for name, array in arrays.items()}
        count, n = data["friction"].shape
        problem = CProblem(n, *(data[name].ctypes.data if name in data else None for name in ARRAYS))
        answers = Answers(np.zeros((count, n, 3)), np.zeros((count, n)), np.zeros(count, ANSWER))
        pointers = [ctypes.c_void_p(array.ctypes.data) for array in answers]
        self._library.solve_many_grasps(count, ctypes.byref(problem), *pointers)
        return answers
