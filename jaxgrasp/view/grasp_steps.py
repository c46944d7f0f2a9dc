"""The grasps of a file one after another, the best or the worst first, each with the answers of both laws."""

from functools import partial
from typing import Literal

import jax
import numpy as np

from jaxgrasp.batch.contact_sets import ContactSets
from jaxgrasp.batch.evaluation import evaluate
from jaxgrasp.batch.reasons import HELD, Reason
from jaxgrasp.batch.worst import case_title, cases_of
from jaxgrasp.force.distribution import closed_form, constrained_optimum
from jaxgrasp.grip.monitor import Assessment, Law, assess
from jaxgrasp.model.arrays import AnyArray
from jaxgrasp.model.grasp import Grasp
from jaxgrasp.model.limits import Limits
from jaxgrasp.model.solution import is_balanced
from jaxgrasp.view.seen import Judged, Seen, judged_by_both

Order = Literal["best first", "worst first", "as in the file"]
BESIDE_A_HAND = 0.04
"""How far contacts on an object in a human hand are from their middle, about [m]."""


class GraspSteps:
    """Every grasp under each of its wrenches: a problem each."""

    def __init__(self, sets: ContactSets, law: Law):
        """Answers all of them at once, for their order; what is shown of one is computed when it is."""
        self.sets, self._law = sets, law
        found = evaluate(sets, methods=("B", "B-optimum"), dtype="float64")
        self._why = found.why.ravel()
        self._orders = orders(np.isin(self._why, HELD), _ranked(found.results["B"]))
        self._width = sets.largest
        reach = sets.reach()
        self._sizes = np.where(reach > 0, reach / BESIDE_A_HAND, 1.0)
        self.size = float(np.median(self._sizes))
        """How many times as large grasps are as one of a human hand, mostly."""

    def __len__(self) -> int:
        return len(self.sets) * self.sets.wrenches

    def problem(self, order: Order, place: int) -> int:
        """Which problem stands at a place of an order, from 0."""
        return int(self._orders[order][place])

    def title(self, problem: int) -> str:
        """Its own name, or its number; with its wrench where there are several."""
        case = cases_of(self.sets, {}, "B", [problem], np.arange(len(self.sets)))[0]
        return case_title(case, self.sets.wrenches > 1)

    def size_of(self, problem: int) -> float:
        """How many times as large it is as a grasp of a human hand."""
        return float(self._sizes[problem // self.sets.wrenches])

    def reason(self, problem: int) -> Reason:
        """Why it does not hold, or that it does."""
        return Reason(int(self._why[problem]))

    def seen(self, problem: int) -> Seen:
        """A problem with its answers, its contacts' middle at the world's origin."""
        number, load = divmod(problem, self.sets.wrenches)
        one = self.sets.rows(np.array([number]))
        grasp, limits = jax.tree.map(
            lambda leaf: np.asarray(leaf[0], float), (self._padded(one), one.limits(self._width))
        )
        wrench = np.asarray(one.wrench[0, load], float)
        assessment, judged = jax.device_get(_answered(grasp, wrench, limits, law=self._law))
        origin = -np.asarray(one.points, float).mean(0)
        return Seen(
            grasp=grasp,
            origin=origin,
            wrench=wrench,
            assessment=assessment,
            **judged._asdict(),
            law=self._law,
            names=[f"contact {k + 1}" for k in range(self._width)],
            object_pose=np.concatenate([np.eye(3), origin[:, None]], 1),
        )

    def edges(self, problem: int) -> np.ndarray:
        """Lines ``(width, 2, 3)`` from the contacts to their middle, which stand for the object [m]."""
        points = self.sets.grasp(problem // self.sets.wrenches).points
        middle = points.mean(0)
        lines = np.tile(middle, (self._width, 2, 1))
        lines[: len(points), 1] = points
        return lines

    def _padded(self, one: ContactSets) -> Grasp:
        """With ``present`` always, so that all are one shape."""
        padded = one.padded(self._width)
        there = np.arange(self._width) < one.sizes[:, None]
        return Grasp(
            padded.points, padded.normals, padded.friction, padded.squeeze, there.astype(float), padded.torsion
        )


def orders(holds: np.ndarray, margins: np.ndarray) -> dict[Order, np.ndarray]:
    """Problems in each order: those that hold are better than others, then those of larger margin; NaN has none.

    Args:
        holds: ``(P,)`` booleans.
        margins: ``(P,)`` [rad]
    """
    known = np.where(np.isnan(margins), -np.inf, margins)
    # Of equal ones the first of the file comes first at either end.
    best, worst = np.lexsort((-known, ~holds)), np.lexsort((known, holds))
    return {"best first": best, "worst first": worst, "as in the file": np.arange(len(holds))}


def _ranked(result) -> np.ndarray:
    """Smallest friction margins of the closed form, where it balances anything: as the report ranks grasps."""
    return np.where(is_balanced(result.verdict), result.margin, np.nan).ravel()


@partial(jax.jit, static_argnames="law")
def _answered(grasp: Grasp, wrench: AnyArray, limits: Limits | None, *, law: Law) -> tuple[Assessment, Judged]:
    assessment = assess(grasp, closed_form(grasp, wrench), constrained_optimum(grasp, wrench, limits=limits), law)
    return assessment, judged_by_both(grasp, assessment)
