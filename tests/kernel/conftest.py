from functools import cache, partial
from typing import Any

import jax
import numpy as np
import pytest

from benchmarks.kernel_calls import ANSWER, Answers, Kernel, has_compiler
from jaxgrasp import kernel as package
from jaxgrasp.problem.batch_last import ProblemBatch
from jaxgrasp.solver import in_kernel
from jaxgrasp.solver.in_kernel import Wanted
from jaxgrasp.solver.result import PhaseResult

# Compiled in half the time of -O3.
QUICK = ("-O1", "-march=native")


class WarpKernel:
    """The kernel as Warp compiles it, with the interface of ``Kernel``."""

    def solve(self, **arrays: np.ndarray) -> Answers:
        """Solve problems ``(B, n, ...)``."""
        return answers_of(solve_batch(problem_of(arrays), Wanted(closed_form=False, optimum=True))[0])


def solve_batch(problem: ProblemBatch, wanted: Wanted) -> tuple[PhaseResult, ...]:
    """Return the wanted results of a flat batch by the kernel, as NumPy's arrays; it must support the batch."""
    assert in_kernel.supports(problem)
    result = jax.device_get(_program(wanted)(problem))
    return (result,) if isinstance(result, PhaseResult) else result


@cache
def _program(wanted: Wanted) -> Any:
    return jax.jit(partial(in_kernel.solve_traced, wanted=wanted, phases=_refuse))


def _refuse(problem: ProblemBatch) -> None:
    raise AssertionError("the phases are traced")


def problem_of(arrays: dict[str, Any]) -> ProblemBatch:
    """Return a flat batch of NumPy's arrays; the weights are the squeeze where none are given."""
    return ProblemBatch(**({"weights": arrays["squeeze"], "present": None} | arrays))


def answers_of(result: Any) -> Answers:
    """Return a result of the solver as the C interface returns it."""
    answer = np.zeros(len(result.verdict), ANSWER)
    for name in ANSWER.names:
        answer[name] = getattr(result, name)
    moments = np.zeros(result.forces.shape[:2]) if result.moments is None else np.asarray(result.moments)
    return Answers(np.asarray(result.forces), moments, answer)


@pytest.fixture(scope="session")
def compiled_by_gcc(tmp_path_factory) -> Kernel:
    """Compile the C++ kernel by g++, once."""
    if not has_compiler():
        pytest.skip("g++ is not installed")
    return Kernel(tmp_path_factory.mktemp("kernel"), QUICK)


@pytest.fixture(params=["g++", "warp"])
def kernel(request) -> Any:
    """Return the kernel, by either compiler."""
    if request.param == "g++":
        return request.getfixturevalue("compiled_by_gcc")
    pytest.importorskip("warp")
    return WarpKernel()


@pytest.fixture
def used_kernel(monkeypatch) -> None:
    """Have public functions use the kernel, which other tests do not."""
    pytest.importorskip("warp")
    monkeypatch.setattr(package, "_choice", True)
