"""Problems of soft fingers and of limited hands, made from ordinary and nasty ones; NumPy alone.

Limits are drawn about the forces behind a feasible wrench, so that these stay allowed: what was feasible stays so.
"""

from typing import Any, NamedTuple

import numpy as np

from jaxgrasp.model.grasp import BOUNDS, Grasp, Limits
from jaxgrasp.testing.limited_reference import Case
from jaxgrasp.testing.problems import problems
from jaxgrasp.testing.references import Problems

TURNED = 0.5
"""Part of the torsional friction that the moments behind a feasible wrench use at most."""


class LimitedProblems(NamedTuple):
    """Batch of problems with limits; None stands for limits that are not asked for."""

    problem: Problems
    """Problems whose wrench is that of the witness's forces and of the moments."""
    torsion: np.ndarray | None
    normal_min: np.ndarray | None
    normal_max: np.ndarray | None
    torque_map: np.ndarray | None
    torque_max: np.ndarray | None

    @property
    def grasp(self) -> Grasp:
        p = self.problem
        return Grasp(p.points, p.normals, p.friction, p.squeeze, torsion=self.torsion)

    @property
    def limits(self) -> Limits:
        return Limits(**{name: getattr(self, name) for name in BOUNDS})

    def case(self, index: int | np.integer, weights: np.ndarray) -> Case:
        """Return the problem at ``index``, with its row of the sharing weights ``(B, n)``, for the reference."""
        p = self.problem
        rows = [getattr(p, name)[index] for name in ("points", "normals", "friction", "squeeze", "wrench")]
        limits = {name: getattr(self, name) for name in ("torsion", *BOUNDS)}
        limit_rows: dict[str, Any] = {name: None if x is None else x[index] for name, x in limits.items()}
        points, normals, friction, squeeze, wrench = rows
        return Case(points, normals, friction, squeeze, wrench, weights[index], **limit_rows)


def limited_problems(
    kind: str, n: int, count: int, seed: int, *, soft: bool = False, bounded: bool = False, joints: int = 0
) -> LimitedProblems:
    """Add soft fingers, bounds of normal forces and ``joints`` limited joints to ``jaxgrasp.testing.problems``.

    Each joint moves about half of the contacts. Kinds without a witness keep their wrench, and get limits about the
    squeezing forces.
    """
    problem = problems(kind, n, count, seed)
    rng = np.random.default_rng([seed, n, joints])
    forces = problem.witness
    if forces is None:
        forces = problem.squeeze[..., None] * problem.normals
    press = np.sum(forces * problem.normals, -1)
    moments, torsion = np.zeros_like(press), None
    if soft:
        torsion = rng.uniform(0, 0.02, press.shape) * problem.friction * (rng.uniform(size=press.shape) < 0.7)
        moments = TURNED * torsion * press * rng.uniform(-1, 1, press.shape)
        problem = problem._replace(wrench=problem.wrench + _turning(problem, moments))
    limited = LimitedProblems(problem, torsion, None, None, None, None)
    if bounded:
        most = press * (1 + rng.exponential(0.5, press.shape))
        most = np.where(rng.uniform(size=press.shape) < 0.3, np.inf, most)
        limited = limited._replace(normal_min=press * rng.uniform(0, 1, press.shape), normal_max=most)
    if joints:
        moved = rng.uniform(size=(*press.shape, 1, joints)) < 0.5
        arms = 0.05 * rng.normal(size=(*press.shape, 4 if soft else 3, joints)) * moved
        pushes = np.concatenate([forces, moments[..., None]], -1)[..., : arms.shape[2]]
        torque = np.abs(np.einsum("bnc,bncj->bj", pushes, arms))
        size = np.einsum("bnc,bncj->bj", np.abs(pushes), np.abs(arms))
        limited = limited._replace(torque_map=arms, torque_max=torque + rng.exponential(0.05, size.shape) * size)
    return limited


def _turning(problem: Problems, moments: np.ndarray) -> np.ndarray:
    """Return the wrenches ``(B, 6)`` of ``moments`` ``(B, n)`` about the normals."""
    torque = (moments[..., None] * problem.normals).sum(-2)
    return np.concatenate([0 * torque, torque], -1)
