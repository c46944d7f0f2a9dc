"""The page beside a haptic loop: hand and object as the loop has them, read out of its slot.

Latency from a glove's reading to the browser's picture, measured while the page runs.
"""

import statistics
import threading
import time
from collections import deque
from typing import Any

import numpy as np

from jaxgrasp.glove.glove_device import LinkState
from jaxgrasp.glove.guard import GuardState
from jaxgrasp.glove.loop.exchange import Slot
from jaxgrasp.hand.to_grasp import GripType
from jaxgrasp.lab.glove_hand import GloveHand
from jaxgrasp.model.hand import Pose
from jaxgrasp.report.look import MUTED, seconds
from jaxgrasp.report.surfaces import link_surfaces, placed, shape_surface
from jaxgrasp.view.drawing import SolvedGrasp
from jaxgrasp.view.live_scene import LiveScene, moving_surfaces, standing_surfaces
from jaxgrasp.view.page_loop import PageLoop
from jaxgrasp.view.panel_words import FeltNotice, felt_torques_html
from jaxgrasp.view.view_slots import Carried, ViewFrame
from jaxgrasp.view.viewer import EYE, Viewer

N_FRAMES = 60
"""Number of latest frames in the median."""
RATE_WINDOW = 1.0
"""Time over which frames are counted [s]."""
ASK_PERIOD = 1.0
"""Time between two questions to a browser [s]."""
PATIENCE = 5.0


class Latency:
    """Median times of the latest frames, and how soon a browser answers."""

    def __init__(self, server: Any) -> None:
        self._server = server
        self._sent: deque[float] = deque(maxlen=N_FRAMES)
        self._times: deque[float] = deque(maxlen=N_FRAMES)
        self._answer: float | None = None
        self._is_asking = threading.Event()

    def record_frame(self, angles_at: float) -> None:
        """Record that a frame is sent now, with angles that were read at ``angles_at`` [s]."""
        sent_at = time.perf_counter()
        self._sent.append(sent_at - angles_at)
        self._times.append(sent_at)

    def ask(self) -> None:
        """Ask a browser, where there is one, for a sign that it has what was sent; nothing waits for it."""
        clients = self._server.get_clients()
        if clients and not self._is_asking.is_set():
            self._is_asking.set()
            threading.Thread(target=self._wait, args=(next(iter(clients.values())),), daemon=True).start()

    def text(self) -> str:
        """Return the latency in words: frame rate, time from angles to sent picture, and browser's round trip."""
        start = time.perf_counter() - RATE_WINDOW
        n_recent = sum(sent_at >= start for sent_at in self._times)
        if n_recent < 2:
            return ""
        # Frames of the last second alone: of a loop that stands still the rate is not what it was.
        rate = n_recent / min(RATE_WINDOW, max(time.perf_counter() - self._times[0], 1e-9))
        summary = f"{rate:.0f} frames a second; {seconds(statistics.median(self._sent))} from angles to picture sent"
        return summary if self._answer is None else f"{summary}; the browser answers after {seconds(self._answer)}"

    def _wait(self, client: Any) -> None:
        start_s = time.perf_counter()
        try:
            client.local_storage.get_item("jaxgrasp", timeout=PATIENCE)
            self._answer = time.perf_counter() - start_s
        except (RuntimeError, TimeoutError):
            # It has gone, or is busy: nothing is known of it.
            self._answer = None
        time.sleep(ASK_PERIOD)
        self._is_asking.clear()


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
        self._joints = [scene.hand.joints[k] for k in glove_hand.joint_indices]
        self._felt = FeltNotice(server)
        self._shown: ViewFrame | None = None
        self._frame: ViewFrame | None = None
        self._vector: np.ndarray | None = None
        self._grip: GripType | None = None
        self.add_words()
        self._glove_line = server.gui.add_html("")
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
        self._slot.write(ViewFrame(0.0, 0, 0, angles, zeros, zeros, carried.vector(), zeros, zeros).vector())
        self.frame()

    def frame(self, dt: float = 0.0) -> None:
        super().frame(dt)
        if self._frame is not None:
            self._shown = self._frame
            if self._frame.angles_at > 0:
                self._latency.record_frame(self._frame.angles_at)
                self._latency.ask()
        if self._shown is not None:
            newest = self._slot.read()
            self._felt.update(self._shown, self._shown if newest is None else ViewFrame.of(newest, self._channels))
            self.viewer.set_stale(self._felt.is_stale)
            # Without a frame too: the rate of a loop that stands still is not what it was.
            if self._frame is not None or self._felt.is_stale:
                line = glove_html(self._shown, self._latency.text(), self._grip)
                if line != self._glove_line.content:
                    self._glove_line.content = line

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

    def torques_html(self, solved: SolvedGrasp) -> str:
        return "" if self._frame is None else felt_torques_html(self._joints, self._frame)

    def corners(self, solved: SolvedGrasp) -> np.ndarray:
        return placed(self._surface.corners, solved.object_pose)


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
