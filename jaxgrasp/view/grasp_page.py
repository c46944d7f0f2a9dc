"""Page of a file of grasps: each grasp in turn, with its verdicts."""

from typing import Any

import numpy as np

from jaxgrasp.batch.reasons import Reason
from jaxgrasp.report.look import MUTED, format_count, text
from jaxgrasp.report.surfaces import DrawnSurface, placed
from jaxgrasp.view.drawing import drawn_points
from jaxgrasp.view.grasp_steps import GraspSteps
from jaxgrasp.view.page_loop import PageLoop
from jaxgrasp.view.seen import SolvedGrasp
from jaxgrasp.view.viewer import EYE, Viewer

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
