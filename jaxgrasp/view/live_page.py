"""The page of a live hand: sliders beside the picture, and a loop that computes what they ask and shows it."""

import threading
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from jaxgrasp.hand.human_hand import is_human, open_angles
from jaxgrasp.report.surfaces import link_surfaces, placed, shape_surface
from jaxgrasp.view.drawing import Drawing, drawing
from jaxgrasp.view.escape import scaled_twist, share_at
from jaxgrasp.view.live_hand import Controls, LiveHand
from jaxgrasp.view.panel_words import torques_html, words_html
from jaxgrasp.view.seen import Seen
from jaxgrasp.view.viewer import Viewer

RATE = 30.0
"""Frames a second, where anything moves."""
REACH = 40.0
"""How far the object's place can be moved either way [mm]."""
LIFT = 150.0
"""How far the wrist can be lifted [mm]."""
LAYERS = {"friction cones": "cones", "closed form": "B", "optimum": "B-optimum", "load": "load", "hand": "hand"}
"""What can be hidden, by what a person calls it."""
EYE = np.array([0.24, 0.26, 0.17])
"""Where a browser looks from at first, from the object's centre [m]."""


class LivePage:
    """A hand, an object and their controls."""

    def __init__(self, server: Any, hand: LiveHand, runs: bool = False):
        """``runs``: whether time runs on from the start."""
        self._hand, self._server = hand, server
        self._first = hand.at_first()
        scene = hand.made.scene
        self._surface = shape_surface(scene.body.shape)
        self._viewer = Viewer(server, link_surfaces(scene.hand), self._surface)
        self._changed = threading.Event()
        self._changed.set()
        self._drawn: Drawing | None = None
        self._twist: np.ndarray | None = None
        self._since = time.perf_counter()
        self.frames = 0
        """How many were shown."""
        self.milliseconds = 0.0
        """How long the last took, from what was set to what was sent."""
        self._add_controls(runs)
        center = np.asarray(hand.made.placed.origin)
        self._viewer.look_from(center + EYE, center)

    def run(self, goes_on: Callable[[], bool] = lambda: True) -> None:
        """Show what is asked for until it goes on no more."""
        before = time.perf_counter()
        while goes_on():
            now = time.perf_counter()
            if self._changed.is_set() or self._runs.value:
                self.frame(now - before)
            elif self._twist is not None:
                self._viewer.show_escape(self._twist, share_at(now - self._since))
            before = now
            left = 1 / RATE - (time.perf_counter() - now)
            if left > 0 and (self._runs.value or self._twist is not None):
                time.sleep(left)
            elif left > 0:
                self._changed.wait(left)

    def frame(self, dt: float) -> None:
        """Compute and show one instant."""
        begun = time.perf_counter()
        self._changed.clear()
        controls = self.controls()
        seen = self._hand.step(controls, dt) if self._runs.value else self._hand.look(controls)
        self._show(seen)
        self.milliseconds = 1e3 * (time.perf_counter() - begun)
        self.frames += 1

    def controls(self) -> Controls:
        """What the sliders say."""
        angles = np.radians([slider.value for slider in self._joints])
        shift = self._bend.value / 100
        flexes = self._flexes
        angles = np.where(flexes, angles + shift * (self._closed - self._open), angles)
        hand = self._hand.made.scene.hand
        return self._first._replace(
            angles=np.clip(angles, np.asarray(hand.lower), np.asarray(hand.upper)),
            lift=np.array([0.0, 0.0, self._lift.value / 1e3]),
            turn=float(np.radians(self._turn.value)),
            place=np.array([slider.value for slider in self._place]) / 1e3,
            friction=float(self._friction.value),
            squeeze=float(self._squeeze.value),
            mass=float(self._mass.value) / 1e3,
            gravity=self._tilt() @ self._first.gravity,
        )

    def html(self) -> str:
        """The scene as it stands as one page, which opens offline."""
        self.frame(0.0)
        return self._viewer.html()

    def _show(self, seen: Seen) -> None:
        self._drawn = drawing(seen, None if self._drawn is None else self._drawn.scale)
        self._viewer.show(self._drawn)
        self._words.content = words_html(seen, self._drawn.scale)
        self._bars.content = torques_html(seen)
        escape = self._drawn.escape
        if escape is None or self._runs.value or seen.rests:
            self._twist = None
            return
        if self._twist is None:
            self._since = time.perf_counter()
        self._twist = scaled_twist(escape, seen.origin, placed(self._surface.corners, seen.object_pose))

    def _tilt(self) -> np.ndarray:
        return Rotation.from_quat(self._gizmo.wxyz, scalar_first=True).as_matrix()

    def _add_controls(self, runs: bool) -> None:
        gui = self._server.gui
        self._words = gui.add_html("")
        self._add_world(gui)
        self._add_hand(gui)
        with gui.add_folder("torques", expand_by_default=False):
            self._bars = gui.add_html("")
        with gui.add_folder("time", expand_by_default=runs):
            self._runs = gui.add_checkbox("time runs", runs)
            again = gui.add_button("put the object back")
        with gui.add_folder("layers", expand_by_default=False):
            for label, part in LAYERS.items():
                box = gui.add_checkbox(label, True)
                box.on_update(lambda _, part=part, box=box: self._viewer.set_visible(part, box.value))
        self._runs.on_update(lambda _: self._start_again())
        again.on_click(lambda _: self._start_again())

    def _add_world(self, gui: Any) -> None:
        first = self._first
        self._friction = self._slider(gui, "friction", 0.0, max(1.5, 1.5 * first.friction), 0.01, first.friction)
        self._squeeze = self._slider(gui, "squeeze, times", 0.0, 5.0, 0.05, 1.0)
        grams = 1e3 * first.mass
        self._mass = self._slider(gui, "mass [g]", 0.0, max(1000.0, 3 * grams), 5.0, grams)
        with gui.add_folder("object and load", expand_by_default=False):
            self._place = [self._slider(gui, f"{axis} [mm]", -REACH, REACH, 0.5, 0.0) for axis in "xyz"]
            self._turning = gui.add_checkbox("turn the load with the mouse", False)
            upright = gui.add_button("load straight down")
        self._gizmo = self._server.scene.add_transform_controls(
            "/turn", scale=0.06, disable_axes=True, disable_sliders=True, visible=False, depth_test=False,
            position=tuple(np.asarray(self._hand.made.placed.origin, float)),
        )  # fmt: skip
        self._gizmo.on_update(lambda _: self._changed.set())
        self._turning.on_update(lambda _: setattr(self._gizmo, "visible", self._turning.value))
        upright.on_click(lambda _: self._set_upright())

    def _add_hand(self, gui: Any) -> None:
        hand = self._hand.made.scene.hand
        self._closed = np.asarray(self._first.angles)
        self._open = open_angles(hand) if is_human(hand) else np.zeros(len(hand.joints))
        self._flexes = np.array(["abduction" not in name for name in hand.joints])
        self._bend = self._slider(gui, "fingers [% of the way]", -100.0, 15.0, 0.25, 0.0)
        with gui.add_folder("wrist", expand_by_default=False):
            self._lift = self._slider(gui, "lift [mm]", 0.0, LIFT, 1.0, 0.0)
            self._turn = self._slider(gui, "turn [°]", -90.0, 90.0, 1.0, 0.0)
        lower, upper, now = (np.degrees(np.asarray(x, float)) for x in (hand.lower, hand.upper, self._closed))
        self._joints: list[Any] = []
        with gui.add_folder("joints [°]", expand_by_default=False):
            for name, low, high, at in zip(hand.joints, lower, upper, now, strict=True):
                low, high = min(low, at), max(high, at)
                self._joints.append(self._slider(gui, name, float(low), float(high), 0.25, float(at)))

    def _slider(self, gui: Any, label: str, low: float, high: float, step: float, at: float) -> Any:
        slider = gui.add_slider(label, low, high, step, at)
        slider.on_update(lambda _: self._changed.set())
        return slider

    def _set_upright(self) -> None:
        self._gizmo.wxyz = (1.0, 0.0, 0.0, 0.0)
        self._changed.set()

    def _start_again(self) -> None:
        self._hand.start_again()
        self._changed.set()
