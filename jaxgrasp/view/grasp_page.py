"""Page of a file of grasps: each grasp in turn, with its verdicts.

The grasps of a file one after another, the best or the worst first, each with the answers of both laws.
"""

from functools import partial
from typing import Any, Literal

import jax
import numpy as np

from jaxgrasp.batch.chunk_statistics import case_title, cases_of
from jaxgrasp.batch.contact_sets import ContactSets
from jaxgrasp.batch.evaluation import evaluate
from jaxgrasp.batch.reasons import HELD, Reason
from jaxgrasp.force.distribution import closed_form, constrained_optimum
from jaxgrasp.grip.monitor import Assessment, Law, assess
from jaxgrasp.model.arrays import AnyArray
from jaxgrasp.model.grasp import Grasp, Limits
from jaxgrasp.model.solution import is_balanced
from jaxgrasp.report.look import MUTED, format_count, text
from jaxgrasp.report.surfaces import DrawnSurface, placed
from jaxgrasp.view.drawing import LawComparison, SolvedGrasp, compare_laws, drawn_points
from jaxgrasp.view.page_loop import PageLoop
from jaxgrasp.view.viewer import EYE, Viewer

Order = Literal["best first", "worst first", "as in the file"]
BESIDE_A_HAND = 0.04
"""Approximate distance of contacts from their mean on an object in a human hand [m]."""


class GraspSteps:
    """Every grasp under each of its wrenches: a problem each."""

    def __init__(self, sets: ContactSets, law: Law):
        """Evaluate all problems at once, for their order; `solve` computes the details of a shown problem."""
        self.sets, self._law = sets, law
        evaluation = evaluate(sets, methods=("B", "B-optimum"), dtype="float64")
        self._reasons = evaluation.why.ravel()
        self._orders = orders(np.isin(self._reasons, HELD), _ranked(evaluation.results["B"]))
        self._width = sets.largest
        reach = sets.reach()
        self._sizes = np.where(reach > 0, reach / BESIDE_A_HAND, 1.0)
        self.size = float(np.median(self._sizes))
        """Median size of the grasps relative to a grasp of a human hand."""

    def __len__(self) -> int:
        return len(self.sets) * self.sets.wrenches

    def problem(self, order: Order, rank: int) -> int:
        """Return the problem at a place, from 0, of an order."""
        return int(self._orders[order][rank])

    @property
    def wrenches(self) -> int:
        """Number of wrenches of each grasp."""
        return self.sets.wrenches

    def rank(self, order: Order, problem: int) -> int:
        """Return the place of a problem, from 0, in an order."""
        return int(np.flatnonzero(self._orders[order] == problem)[0])

    def title(self, problem: int) -> str:
        """Return the name of a problem's grasp, or its number; with the wrench where grasps have several."""
        case = cases_of(self.sets, {}, "B", [problem], np.arange(len(self.sets)))[0]
        return case_title(case, self.sets.wrenches > 1)

    def size_of(self, problem: int) -> float:
        """Return the size of a problem's grasp relative to a grasp of a human hand."""
        return float(self._sizes[problem // self.sets.wrenches])

    def reason(self, problem: int) -> Reason:
        """Return the failure reason of a problem, or the reason that states that it holds."""
        return Reason(int(self._reasons[problem]))

    def solve(self, problem: int) -> SolvedGrasp:
        """Solve a problem by both laws, with the mean of its contacts at the world's origin."""
        number, load = divmod(problem, self.sets.wrenches)
        single = self.sets.rows(np.array([number]))
        grasp, limits = jax.tree.map(
            lambda leaf: np.asarray(leaf[0], float), (self._padded(single), single.limits(self._width))
        )
        wrench = np.asarray(single.wrench[0, load], float)
        assessment, comparison = jax.device_get(_answered(grasp, wrench, limits, law=self._law))
        origin = -np.asarray(single.points, float).mean(0)
        return SolvedGrasp(
            grasp=grasp,
            origin=origin,
            wrench=wrench,
            assessment=assessment,
            **comparison._asdict(),
            law=self._law,
            names=[f"contact {k + 1}" for k in range(self._width)],
            object_pose=np.concatenate([np.eye(3), origin[:, None]], 1),
        )

    def edges(self, problem: int) -> np.ndarray:
        """Return lines ``(width, 2, 3)`` [m] from the contacts to their mean, which stand for the object."""
        points = self.sets.grasp(problem // self.sets.wrenches).points
        middle = points.mean(0)
        lines = np.tile(middle, (self._width, 2, 1))
        lines[: len(points), 1] = points
        return lines

    def _padded(self, single: ContactSets) -> Grasp:
        """Pad the contacts to the largest grasp and set ``present``, so that all grasps have the same shapes."""
        padded = single.padded(self._width)
        present = np.arange(self._width) < single.sizes[:, None]
        return Grasp(
            padded.points, padded.normals, padded.friction, padded.squeeze, present.astype(float), padded.torsion
        )


def orders(holds: np.ndarray, margins: np.ndarray) -> dict[Order, np.ndarray]:
    """Sort the problems in each order: holding is better than failing, then a larger margin; NaN is no margin.

    Args:
        holds: ``(P,)`` booleans.
        margins: ``(P,)`` [rad]
    """
    sortable = np.where(np.isnan(margins), -np.inf, margins)
    # Of equal ones the first of the file comes first at either end.
    best, worst = np.lexsort((-sortable, ~holds)), np.lexsort((sortable, holds))
    return {"best first": best, "worst first": worst, "as in the file": np.arange(len(holds))}


def _ranked(result) -> np.ndarray:
    """Return the closed form's smallest friction margins, NaN if unbalanced: the report's ranking of grasps."""
    return np.where(is_balanced(result.verdict), result.margin, np.nan).ravel()


@partial(jax.jit, static_argnames="law")
def _answered(grasp: Grasp, wrench: AnyArray, limits: Limits | None, *, law: Law) -> tuple[Assessment, LawComparison]:
    assessment = assess(grasp, closed_form(grasp, wrench), constrained_optimum(grasp, wrench, limits=limits), law)
    return assessment, compare_laws(grasp, assessment)


CLOSER = 0.7
"""Distance of the eye to contacts without a hand, as a share of that to a hand."""


class GraspPage(PageLoop):
    """Grasps, their order, and the index of the shown problem."""

    def __init__(
        self,
        server: Any,
        steps: GraspSteps,
        object_surface: DrawnSurface | None = None,
        *,
        file_name: str = "",
        grasp: int | None = None,
    ):
        """Create the page.

        Args:
            server: viser server of the page.
            steps: the grasps.
            object_surface: the object in the contacts' frame, or None to draw lines from the contacts.
            file_name: of the file, for the title.
            grasp: number of the grasp that is shown first, from 0; the best where not given.
        """
        super().__init__(Viewer(server, object_surface=object_surface), steps.size)
        self._steps, self._object_surface, self._file_name = steps, object_surface, file_name
        gui = server.gui
        self._heading = gui.add_html("")
        self.add_words()
        with gui.add_folder("which grasp"):
            self.order = gui.add_dropdown("order", ("best first", "worst first", "as in the file"))
            self.rank = gui.add_slider("place", 1, max(2, len(steps)), 1, 1, disabled=len(steps) < 2)
            step = gui.add_button_group("", ("previous", "next"))
        self.add_tables(with_torques=False)
        with gui.add_folder("layers", expand_by_default=False):
            self.viewer.add_layers()
        self.order.on_update(lambda _: self._go_to(1))
        self.rank.on_update(self.change)
        step.on_click(lambda _: self._go_to(self.rank.value + (1 if step.value == "next" else -1)))
        self.viewer.look_from(CLOSER * EYE * self.size, np.zeros(3))
        if grasp is not None:
            self.rank.value = 1 + steps.rank(self.order.value, grasp * steps.wrenches)
        self.frame()
        assert self._drawn is not None
        self.viewer.fit(drawn_points(self._drawn))

    @property
    def title(self) -> str:
        """The file and the grasp."""
        return ": ".join(filter(None, (self._file_name, self._steps.title(self.problem))))

    @property
    def problem(self) -> int:
        """Index in the file of the shown problem."""
        return self._steps.problem(self.order.value, min(int(self.rank.value), len(self._steps)) - 1)

    def solve_frame(self, dt: float) -> SolvedGrasp:
        problem = self.problem
        self.size = self._steps.size_of(problem)
        if self._object_surface is None:
            self.viewer.set_edges(self._steps.edges(problem))
        position = f"{format_count(int(self.rank.value))} of {format_count(len(self._steps))}, {self.order.value}"
        self._heading.content = (
            f'<div style="font: 650 16px/1.4 system-ui, sans-serif;padding:4px 10px 0">'
            f'{text(self._steps.title(problem))} <span style="color:{MUTED};font-weight:400;font-size:13px">{position}'
            "</span></div>"
        )
        return self._steps.solve(problem)

    def corners(self, solved: SolvedGrasp) -> np.ndarray:
        if self._object_surface is None:
            return solved.points[solved.touching]
        return placed(self._object_surface.corners, solved.object_pose)

    def verdict_html(self, solved: SolvedGrasp) -> str:
        reason = self._steps.reason(self.problem)
        if reason == Reason.HOLDS:
            return super().verdict_html(solved)
        lead = "It " if reason == Reason.HARDER else "Why not: "
        return super().verdict_html(solved) + (
            f'<div style="font: 13px/1.4 system-ui, sans-serif;padding:0 10px 8px"><b>{lead}{text(reason.title)}.</b> '
            f"{text(reason.advice)}</div>"
        )

    def _go_to(self, rank: int) -> None:
        self.rank.value = min(max(int(rank), 1), len(self._steps))
        self.change()
