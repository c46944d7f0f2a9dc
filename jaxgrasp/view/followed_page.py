"""The page beside a haptic loop: hand and object as the loop has them, read out of its slot."""

from typing import Any

import numpy as np

from jaxgrasp.glove.glove_device import LinkState
from jaxgrasp.glove.guard import GuardState
from jaxgrasp.glove.loop.slot import Slot
from jaxgrasp.hand.grip_type import GripType
from jaxgrasp.lab.glove_hand import GloveHand
from jaxgrasp.model.hand import Pose
from jaxgrasp.report.look import MUTED
from jaxgrasp.report.surfaces import link_surfaces, placed, shape_surface
from jaxgrasp.view.latency import Latency
from jaxgrasp.view.live_scene import LiveScene
from jaxgrasp.view.page_loop import PageLoop
from jaxgrasp.view.seen import Seen
from jaxgrasp.view.standing_surfaces import moving_surfaces, standing_surfaces
from jaxgrasp.view.view_slots import Carried, ViewFrame
from jaxgrasp.view.viewer import EYE, Viewer


class FollowedPage(PageLoop):
    """A hand in a glove, seen."""

    def __init__(self, server: Any, hand: LiveScene, worn: GloveHand, slot: Slot):
        scene = hand.made.scene
        self._surface = shape_surface(scene.body.shape)
        standing = standing_surfaces(scene, hand.made.placed)
        links = link_surfaces(scene.hand)
        super().__init__(Viewer(server, links, self._surface, standing, hand.others, moving_surfaces(scene)))
        self._hand, self._worn, self._slot = hand, worn, slot
        self._channels = len(worn.joint_indices)
        self._latency = Latency(server)
        self._frame: ViewFrame | None = None
        self._vector: np.ndarray | None = None
        self._grip: GripType | None = None
        self.add_words()
        self.add_tables()
        with server.gui.add_folder("layers", expand_by_default=False):
            self.viewer.add_layers()
        self.viewer.look_from(EYE, np.asarray(hand.made.placed.origin))

    @property
    def runs(self) -> bool:
        return True

    def at_first(self) -> None:
        """Show the hand as it is closed in the scene: nothing was read yet, and all is compiled by then."""
        angles = np.asarray(self._hand.made.closed.angles)[list(self._worn.joint_indices)]
        nothing = np.zeros(self._channels)
        carried = Carried.at(self._hand.made.closed.wrist, self._hand.begun)
        self._slot.write(ViewFrame(0.0, 0, 0, angles, nothing, nothing, carried.vector()).vector())
        self.frame()

    def frame(self, passed: float = 0.0) -> None:
        super().frame(passed)
        if self._frame is not None and self._frame.angles_at > 0:
            self._latency.shown(self._frame.angles_at)
            self._latency.ask()

    def seen(self, passed: float) -> Seen | None:
        vector = self._slot.read()
        if vector is None or vector is self._vector:
            self._frame = None
            return None
        self._vector, self._frame = vector, ViewFrame.of(vector, self._channels)
        carried = Carried.of(self._frame.more, 1 + len(self._hand.others))
        self._grip = carried.followed.grip
        wrist = Pose(carried.wrist[:, 3], carried.wrist[:, :3])
        return self._hand.follow(self._worn.posture(self._frame.angles, wrist), carried.followed)

    def corners(self, seen: Seen) -> np.ndarray:
        return placed(self._surface.corners, seen.object_pose)

    def said(self, seen: Seen) -> str:
        return super().said(seen) + glove_html(self._frame, self._latency.text(), self._grip)


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
