"""This package's own optimum as a solver of the suite: by JAX or by the compiled kernel, in either precision."""

import time
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import jax
import numpy as np

import jaxgrasp
from jaxgrasp import Grasp, Limits, Verdict
from jaxgrasp.kernel import is_used, use_kernel
from jaxgrasp.testing.suite import Answer, Claim, SuiteProblem

CLAIMS = {
    Verdict.OPTIMAL: Claim.SOLVED,
    Verdict.CLOSED_FORM_OPTIMAL: Claim.SOLVED,
    Verdict.INFEASIBLE: Claim.INFEASIBLE,
    Verdict.NO_CONTACTS: Claim.INFEASIBLE,
}
"""Verdicts that claim something; any other says that the problem is not decided."""


ROOMS = (5, 15)
"""Numbers of contacts to which problems are padded, so that a few programs serve all of them."""


@dataclass(frozen=True)
class OwnSolver:
    """``constrained_optimum``, called once for all problems of a shape, padded by absent contacts.

    Scaling and settings are its own: it has none to choose. The times are those of a second call, over the number of
    problems in it.
    """

    name: str

    @property
    def tolerance(self) -> float:
        """Gap that its verdicts promise."""
        return 1e-6 if "float32" in self.name else 1e-8

    def solve_all(self, problems: Sequence[SuiteProblem]) -> list[Answer]:
        """Solve all problems.

        Raises:
            ImportError: for the kernel where the extra ``kernel`` is not installed.
        """
        was_used = is_used()
        use_kernel("kernel" in self.name)
        try:
            return self._solve_all(problems)
        finally:
            use_kernel(was_used)

    def _solve_all(self, problems: Sequence[SuiteProblem]) -> list[Answer]:
        groups = defaultdict(list)
        for i, problem in enumerate(problems):
            joints = None if problem.torque_max is None else len(problem.torque_max)
            groups[_room(problem), problem.torsion is None, joints].append(i)
        answers: list[Answer | None] = [None] * len(problems)
        for indices in groups.values():
            for i, answer in zip(indices, self._solve_group([problems[i] for i in indices]), strict=True):
                answers[i] = answer
        return [answer for answer in answers if answer is not None]

    def _solve_group(self, problems: list[SuiteProblem]) -> list[Answer]:
        dtype = np.float32 if "float32" in self.name else np.float64

        def stacked(name: str, is_per_contact: bool = True) -> Any:
            arrays = [getattr(problem, name) for problem in problems]
            if arrays[0] is None:
                return None
            if is_per_contact:
                arrays = [_padded(array, _room(problems[0])) for array in arrays]
            return np.stack(arrays).astype(dtype)

        with jax.enable_x64(dtype is np.float64):
            points, normals, friction, squeeze = (
                stacked(name) for name in ("points", "normals", "friction", "squeeze")
            )
            present = np.stack([_padded(np.ones(len(p.friction)), _room(p)) for p in problems]).astype(dtype)
            grasp = Grasp(points, normals, friction, squeeze, present=present, torsion=stacked("torsion"))
            limits = None
            # Limits of torques have no last resort.
            last_resort = "last-resort" in self.name and problems[0].torque_max is None
            if problems[0].torque_max is not None:
                limits = Limits(torque_map=stacked("torque_map"), torque_max=stacked("torque_max", False))
            arguments = (grasp, stacked("wrench", False), stacked("weights"))
            options: dict[str, Any] = {"limits": limits, "last_resort": last_resort}
            jax.block_until_ready(jaxgrasp.constrained_optimum(*arguments, **options))
            started = time.perf_counter()
            solution = jax.device_get(jaxgrasp.constrained_optimum(*arguments, **options))
            seconds = (time.perf_counter() - started) / len(problems)
        moments = solution.moments
        return [
            Answer(
                CLAIMS.get(verdict, Claim.FAILED),
                solution.forces[i, : len(problems[i].friction)],
                None if moments is None else moments[i, : len(problems[i].friction)],
                solution.certificate[i],
                seconds,
                verdict.name,
            )
            for i, verdict in enumerate(map(Verdict, solution.verdict))
        ]


def _room(problem: SuiteProblem) -> int:
    n = len(problem.friction)
    return next((room for room in ROOMS if n <= room), n)


def _padded(array: np.ndarray, room: int) -> np.ndarray:
    return np.concatenate([array, np.zeros((room - len(array), *array.shape[1:]))])
