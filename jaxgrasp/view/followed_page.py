"""The page beside a haptic loop: hand and object as the loop has them, read out of its slot."""

from typing import Any

import numpy as np

from jaxgrasp.glove.glove_device import LinkState
from jaxgrasp.glove.guard import GuardState
from jaxgrasp.glove.loop.exchange import Slot
from jaxgrasp.hand.grip_type import GripType
from jaxgrasp.lab.glove_hand import GloveHand
from jaxgrasp.model.hand import Pose
from jaxgrasp.report.look import MUTED
from jaxgrasp.report.surfaces import link_surfaces, placed, shape_surface
from jaxgrasp.view.latency import Latency
from jaxgrasp.view.live_scene import LiveScene
from jaxgrasp.view.page_loop import PageLoop
from jaxgrasp.view.seen import SolvedGrasp
from jaxgrasp.view.standing_surfaces import moving_surfaces, standing_surfaces
from jaxgrasp.view.view_slots import Carried, ViewFrame
from jaxgrasp.view.viewer import EYE, Viewer


class FollowedPage(PageLoop):
    """A hand in a glove, seen."""

    def __init__(self, server: Any, hand: LiveScene, glove_hand: GloveHand, slot: Slot):
        scene = hand.gripped.scene
        self._surface = shape_surface(scene.body.shape)
        fixed = standing_surfaces(scene, hand.gripped.placed)
        links = link_surfaces(scene.hand)
        super().__init__(Viewer(server, links, self._surface, fixed, hand.other_surfaces, moving_surfaces(scene)))
        self._hand, self._glove_hand, self._slot = hand, glove_hand, slot
        self._channels = len(glove_hand.joint_indices)
        self._latency = Latency(server)
        self._frame: ViewFrame | None = None
        self._vector: np.ndarray | None = None
        self._grip: GripType | None = None
        self.add_words()
        self.add_tables()
        with server.gui.add_folder("layers", expand_by_default=False):
            self.viewer.add_layers()
        self.viewer.look_from(EYE, np.asarray(hand.gripped.placed.origin))

    @property
    def runs(self) -> bool:
        return True

    def show_initial(self) -> None:
        """Show the hand as it is closed in the scene: nothing was read yet, and all is compiled by then."""
        angles = np.asarray(self._hand.gripped.closed.angles)[list(self._glove_hand.joint_indices)]
        zeros = np.zeros(self._channels)
        carried = Carried.at(self._hand.gripped.closed.wrist, self._hand.initial_followed)
        self._slot.write(ViewFrame(0.0, 0, 0, angles, zeros, zeros, carried.vector()).vector())
        self.frame()

    def frame(self, dt: float = 0.0) -> None:
        super().frame(dt)
        if self._frame is not None and self._frame.angles_at > 0:
            self._latency.record_frame(self._frame.angles_at)
            self._latency.ask()

    def solve_frame(self, dt: float) -> SolvedGrasp | None:
        vector = self._slot.read()
        if vector is None or vector is self._vector:
            self._frame = None
            return None
        self._vector, self._frame = vector, ViewFrame.of(vector, self._channels)
        carried = Carried.of(self._frame.extra, 1 + len(self._hand.other_surfaces))
        self._grip = carried.followed.grip
        wrist = Pose(carried.wrist[:, 3], carried.wrist[:, :3])
        return self._hand.follow(self._glove_hand.posture(self._frame.angles, wrist), carried.followed)

    def corners(self, solved: SolvedGrasp) -> np.ndarray:
        return placed(self._surface.corners, solved.object_pose)

    def verdict_html(self, solved: SolvedGrasp) -> str:
        return super().verdict_html(solved) + glove_html(self._frame, self._latency.text(), self._grip)


def glove_html(frame: ViewFrame | None, latency: str, grip: GripType | None = None) -> str:
    """Return HTML with the glove's link and guard state, the grip type of the contributions, and the latency."""
    glove = "" if grip is None else f'<span data-grip="{grip.name}">contributions follow: {_words(grip)}</span>. '
    if frame is not None and frame.angles_at > 0:
        glove += f"glove: {LinkState(frame.link).name.lower()}, {GuardState(frame.guard).name.lower()}. "
    return (
        f'<div data-latency style="font: 12px/1.4 system-ui, sans-serif;color:{MUTED};padding:0 10px 6px">'
        f"{glove}{latency}</div>"
    )


def _words(grip: GripType) -> str:
    if grip <= GripType.UNKNOWN:
        return "the scene's own, no grip is known yet"
    return "a " + grip.name.lower().replace("_", " ") + " grip"
