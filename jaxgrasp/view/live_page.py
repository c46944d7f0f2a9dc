"""The page of a live hand: sliders beside the picture."""

from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from jaxgrasp.report.surfaces import link_surfaces, placed, shape_surface
from jaxgrasp.view.drawing import SolvedGrasp
from jaxgrasp.view.live_scene import Controls, LiveScene, moving_surfaces, standing_surfaces
from jaxgrasp.view.page_loop import PageLoop
from jaxgrasp.view.viewer import EYE, Viewer

REACH = 40.0
"""Largest displacement of the object either way [mm]."""
LIFT = 150.0
"""Largest lift of the wrist [mm]."""


class LivePage(PageLoop):
    """A hand, objects and their controls."""

    def __init__(self, server: Any, hand: LiveScene, runs: bool = False, *, name: str = ""):
        """Create the page with its sliders.

        Args:
            server: viser server of the page.
            hand: scene that the sliders move.
            runs: True if time runs from the start.
            name: of the scene, the title of the saved page.
        """
        self._name = name
        scene = hand.gripped.scene
        self._surface = shape_surface(scene.body.shape)
        fixed = standing_surfaces(scene, hand.gripped.placed)
        links = link_surfaces(scene.hand)
        super().__init__(Viewer(server, links, self._surface, fixed, hand.other_surfaces, moving_surfaces(scene)))
        self._hand, self._server = hand, server
        self._first = hand.initial_controls()
        self.sliders: dict[str, Any] = {}
        """Sliders by name: ``friction``, ``squeeze``, ``mass`` [g], ``bend`` [%], ``lift`` [mm], ``turn`` [degrees],
        ``x``, ``y`` and ``z`` of the object [mm], and each joint's name [degrees]."""
        self._add_controls(runs)
        self.viewer.look_from(EYE, np.asarray(hand.gripped.placed.origin))

    @property
    def title(self) -> str:
        """The scene."""
        return self._name

    @property
    def runs(self) -> bool:
        return self._runs.value

    def solve_frame(self, dt: float) -> SolvedGrasp:
        controls = self.controls()
        return self._hand.step(controls, dt) if self.runs else self._hand.look(controls)

    def corners(self, solved: SolvedGrasp) -> np.ndarray:
        return placed(self._surface.corners, solved.object_pose)

    def set(self, **values: float) -> None:
        """Move some sliders, by their names."""
        for name, value in values.items():
            self.sliders[name].value = value
        self.change()

    def controls(self) -> Controls:
        """Return the controls with the values of the sliders."""
        angles = np.radians([self.sliders[name].value for name in self._hand.gripped.scene.hand.joints])
        bend_share = self.sliders["bend"].value / 100
        flexes = self._flexes
        angles = np.where(flexes, angles + bend_share * (self._closed - self._open), angles)
        hand = self._hand.gripped.scene.hand
        return self._first._replace(
            angles=np.clip(angles, np.asarray(hand.lower), np.asarray(hand.upper)),
            lift=np.array([0.0, 0.0, self.sliders["lift"].value / 1e3]),
            turn=float(np.radians(self.sliders["turn"].value)),
            shift=np.array([self.sliders[axis].value for axis in "xyz"]) / 1e3,
            friction=float(self.sliders["friction"].value),
            squeeze=float(self.sliders["squeeze"].value),
            mass=float(self.sliders["mass"].value) / 1e3,
            gravity=self._tilt() @ self._first.gravity,
        )

    def _tilt(self) -> np.ndarray:
        return Rotation.from_quat(self._gizmo.wxyz, scalar_first=True).as_matrix()

    def _add_controls(self, runs: bool) -> None:
        gui = self._server.gui
        self.add_words()
        self._add_world(gui)
        self._add_hand(gui)
        self.add_tables()
        with gui.add_folder("time", expand_by_default=runs):
            self._runs = gui.add_checkbox("time runs", runs)
            reset_button = gui.add_button("put the object back")
        with gui.add_folder("layers", expand_by_default=False):
            opacity = gui.add_slider("hand", 0.0, 1.0, 0.05, 1.0)
            opacity.on_update(lambda _: self.viewer.set_opacity(opacity.value))
            self.viewer.add_layers()
        self._runs.on_update(lambda _: self._start_again())
        reset_button.on_click(lambda _: self._start_again())

    def _add_world(self, gui: Any) -> None:
        first = self._first
        self._slider(gui, "friction", "friction", 0.0, max(1.5, 1.5 * first.friction), 0.01, first.friction)
        self._slider(gui, "squeeze", "squeeze, times", 0.0, 5.0, 0.05, 1.0)
        grams = 1e3 * first.mass
        self._slider(gui, "mass", "mass [g]", 0.0, max(1000.0, 3 * grams), 5.0, grams)
        with gui.add_folder("object and load", expand_by_default=False):
            for axis in "xyz":
                self._slider(gui, axis, f"{axis} [mm]", -REACH, REACH, 0.5, 0.0)
            self._turning = gui.add_checkbox("turn the load with the mouse", False)
            upright = gui.add_button("load straight down")
        self._gizmo = self._server.scene.add_transform_controls(
            "/turn", scale=0.06, disable_axes=True, disable_sliders=True, visible=False, depth_test=False,
            position=tuple(np.asarray(self._hand.gripped.placed.origin, float)),
        )  # fmt: skip
        self._gizmo.on_update(self.change)
        self._turning.on_update(lambda _: setattr(self._gizmo, "visible", self._turning.value))
        upright.on_click(lambda _: self._set_upright())

    def _add_hand(self, gui: Any) -> None:
        hand = self._hand.gripped.scene.hand
        self._closed = np.asarray(self._first.angles)
        self._open = np.asarray(self._hand.gripped.open)
        self._flexes = np.array(["abduction" not in name for name in hand.joints])
        self._slider(gui, "bend", "fingers [% of the way]", -100.0, 15.0, 0.25, 0.0)
        with gui.add_folder("wrist", expand_by_default=False):
            self._slider(gui, "lift", "lift [mm]", 0.0, LIFT, 1.0, 0.0)
            self._slider(gui, "turn", "turn [°]", -90.0, 90.0, 1.0, 0.0)
        lower, upper, initial = (np.degrees(np.asarray(x, float)) for x in (hand.lower, hand.upper, self._closed))
        with gui.add_folder("joints [°]", expand_by_default=False):
            for name, low, high, at in zip(hand.joints, lower, upper, initial, strict=True):
                low, high = min(low, at), max(high, at)
                self._slider(gui, name, name, float(low), float(high), 0.25, float(at))

    def _slider(self, gui: Any, name: str, label: str, low: float, high: float, step: float, at: float) -> None:
        self.sliders[name] = gui.add_slider(label, low, high, step, at)
        self.sliders[name].on_update(self.change)

    def _set_upright(self) -> None:
        self._gizmo.wxyz = (1.0, 0.0, 0.0, 0.0)
        self.change()

    def _start_again(self) -> None:
        self._hand.reset()
        self.change()
