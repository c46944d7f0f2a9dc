"""Page of a file of grasps: each grasp in turn, with its verdicts."""

from typing import Any

import numpy as np

from jaxgrasp.batch.reasons import Reason
from jaxgrasp.report.look import MUTED, text, whole
from jaxgrasp.report.surfaces import DrawnSurface, placed
from jaxgrasp.view.grasp_steps import GraspSteps
from jaxgrasp.view.page_loop import PageLoop
from jaxgrasp.view.seen import Seen
from jaxgrasp.view.viewer import EYE, Viewer

CLOSER = 0.7
"""Distance of the eye to contacts without a hand, as a share of that to a hand."""


class GraspPage(PageLoop):
    """Grasps, their order, and the index of the shown problem."""

    def __init__(self, server: Any, steps: GraspSteps, thing: DrawnSurface | None = None):
        """Create the page; ``thing`` is the object in the contacts' frame, or None to draw lines from the contacts."""
        super().__init__(Viewer(server, thing=thing), steps.size)
        self._steps, self._thing = steps, thing
        gui = server.gui
        self._title = gui.add_html("")
        self.add_words()
        with gui.add_folder("which grasp"):
            self.order = gui.add_dropdown("order", ("best first", "worst first", "as in the file"))
            self.place = gui.add_slider("place", 1, max(2, len(steps)), 1, 1, disabled=len(steps) < 2)
            step = gui.add_button_group("", ("previous", "next"))
        self.add_tables(with_torques=False)
        with gui.add_folder("layers", expand_by_default=False):
            self.viewer.add_layers()
        self.order.on_update(lambda _: self._go_to(1))
        self.place.on_update(self.change)
        step.on_click(lambda _: self._go_to(self.place.value + (1 if step.value == "next" else -1)))
        self.viewer.look_from(CLOSER * EYE * self.size, np.zeros(3))
        self.change()

    @property
    def problem(self) -> int:
        """Index in the file of the shown problem."""
        return self._steps.problem(self.order.value, min(int(self.place.value), len(self._steps)) - 1)

    def seen(self, passed: float) -> Seen:
        problem = self.problem
        self.size = self._steps.size_of(problem)
        if self._thing is None:
            self.viewer.set_edges(self._steps.edges(problem))
        place = f"{whole(int(self.place.value))} of {whole(len(self._steps))}, {self.order.value}"
        self._title.content = (
            f'<div style="font: 650 16px/1.4 system-ui, sans-serif;padding:4px 10px 0">'
            f'{text(self._steps.title(problem))} <span style="color:{MUTED};font-weight:400;font-size:13px">{place}'
            "</span></div>"
        )
        return self._steps.seen(problem)

    def corners(self, seen: Seen) -> np.ndarray:
        if self._thing is None:
            return seen.points[seen.there]
        return placed(self._thing.corners, seen.object_pose)

    def said(self, seen: Seen) -> str:
        why = self._steps.reason(self.problem)
        if why == Reason.HOLDS:
            return super().said(seen)
        lead = "It " if why == Reason.HARDER else "Why not: "
        return super().said(seen) + (
            f'<div style="font: 13px/1.4 system-ui, sans-serif;padding:0 10px 8px"><b>{lead}{text(why.title)}.</b> '
            f"{text(why.advice)}</div>"
        )

    def _go_to(self, place: int) -> None:
        self.place.value = min(max(int(place), 1), len(self._steps))
        self.change()
