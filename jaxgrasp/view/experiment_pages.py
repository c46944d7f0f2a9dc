"""Two pages beside an experiment: the subject's shows the scene and what to answer, the experimenter's the rest."""

import time
from collections.abc import Callable
from functools import cached_property
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxgrasp.glove.loop.exchange import Slot
from jaxgrasp.glove.model import GloveModel
from jaxgrasp.hand.human_hand import human_hand, open_angles
from jaxgrasp.hand.kinematics import pose_hand
from jaxgrasp.hand.shapes import Box, Cylinder
from jaxgrasp.lab.felt_objects import PALM_UP, WIDTH, FeltObject, Lifted, Squeezed
from jaxgrasp.lab.glove_hand import GloveHand, glove_hand
from jaxgrasp.model.arrays import AnyArray
from jaxgrasp.model.hand import Hand
from jaxgrasp.report.surfaces import DrawnSurface, link_surfaces, pose_matrix, shape_surface
from jaxgrasp.view.followed_page import Latency, glove_html
from jaxgrasp.view.page_loop import RATE
from jaxgrasp.view.panel_words import AT_EXPERIMENT, FeltNotice, felt_torques_html
from jaxgrasp.view.view_slots import TrialState, ViewFrame
from jaxgrasp.view.viewed_person import experimenter_html, subject_html
from jaxgrasp.view.viewer import Viewer

BAR, LENGTH = 0.006, 0.13
"""Radius and length of the bar that is lifted [m]."""
EYE = np.array([-0.16, 0.34, 0.17])
"""Position of the eye relative to the hand, whose palm faces up [m]."""
AMID = np.array([0.1, 0.0, 0.02])
"""Centre of the view [m]."""


class FeltScene:
    """Hand of an experiment and the object that it lifts or squeezes, as bodies."""

    def __init__(self, felt_object: FeltObject, model: GloveModel):
        self._felt_object = felt_object
        self.hand: Hand = felt_object.hand if isinstance(felt_object, Lifted | Squeezed) else human_hand()
        self._glove_hand: GloveHand = (
            felt_object.glove
            if isinstance(felt_object, Lifted | Squeezed)
            else glove_hand(self.hand, model, open_angles(self.hand))
        )
        self._links = jax.jit(lambda angles: pose_hand(self.hand, self._glove_hand.posture(angles, PALM_UP)).links)
        self._at_rest = _at_rest(felt_object)

    @cached_property
    def object_surface(self) -> DrawnSurface | None:
        """The object in its own frame: a bar along y, a block whose x goes from the fingers to the thumb."""
        if isinstance(self._felt_object, Lifted):
            bar = shape_surface(Cylinder(BAR, LENGTH))
            return bar._replace(
                corners=bar.corners[:, [0, 2, 1]], faces=bar.faces[:, ::-1], lines=bar.lines[:, [0, 2, 1]]
            )
        if isinstance(self._felt_object, Squeezed):
            return shape_surface(Box(WIDTH, WIDTH, WIDTH))
        return None

    def bodies(self, angles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the poses of the links ``(L, 3, 4)`` and of the object ``(3, 4)`` at the glove's angles [rad]."""
        return pose_matrix(jax.device_get(self._links(angles))), self._object(angles)

    def _object(self, angles: np.ndarray) -> np.ndarray:
        pose = self._at_rest.copy()
        if isinstance(self._felt_object, Lifted):
            pad_middle = np.asarray(_middle(self._felt_object, angles)) + np.array([0.0, 0.0, BAR])
            # Fingers that sink below its rest leave the bar there.
            pose[:, 3] = pad_middle if pad_middle[2] > pose[2, 3] else pose[:, 3]
        return pose


@jax.jit
def _middle(felt_object: Lifted | Squeezed, angles: AnyArray) -> Array:
    """Return the mean of the pads' positions ``(3,)`` [m] at the glove's angles [rad]."""
    return jnp.mean(felt_object.pads(angles)[1], 0)


def _at_rest(felt_object: FeltObject) -> np.ndarray:
    """Return the object's pose ``(3, 4)`` before the first contact."""
    pose = np.eye(3, 4)
    if isinstance(felt_object, Lifted | Squeezed):
        pose[:, 3] = np.asarray(_middle(felt_object, felt_object.start))
    if isinstance(felt_object, Lifted):
        pose[2, 3] += BAR
    elif isinstance(felt_object, Squeezed):
        x = np.asarray(felt_object.inward())
        y = np.cross([0.0, 0.0, 1.0], x) if abs(x[2]) < 0.9 else np.cross([0.0, 1.0, 0.0], x)
        y /= np.linalg.norm(y)
        pose[:, :3] = np.stack([x, y, np.cross(x, y)], 1)
        pose[:, 3] += WIDTH / 2 * x
    return pose


class ExperimentPages:
    """Both pages, of one scene."""

    def __init__(self, servers: tuple[Any, Any], felt_object: FeltObject, model: GloveModel, kind: str, slot: Slot):
        """Create both pages; ``servers`` are those of the subject's page and of the experimenter's."""
        self._scene, self._model, self._kind, self._slot = FeltScene(felt_object, model), model, kind, slot
        links = link_surfaces(self._scene.hand)
        self._viewers = [Viewer(server, links, self._scene.object_surface) for server in servers]
        for viewer in self._viewers:
            viewer.look_from(EYE, AMID)
        self._felt = [
            FeltNotice(server, AT_EXPERIMENT, tells_reason=tells_reason)
            for server, tells_reason in zip(servers, (False, True), strict=True)
        ]
        self._shown: ViewFrame | None = None
        self._subject_text = servers[0].gui.add_html(subject_html(TrialState(), kind))
        self._experimenter_text = servers[1].gui.add_html(experimenter_html(TrialState(), kind))
        self._glove = servers[1].gui.add_html("")
        with servers[1].gui.add_folder("torques, asked for and given"):
            self._torques = servers[1].gui.add_html("")
        self._latency = Latency(servers[1])
        self._vector: np.ndarray | None = None

    def show_initial(self) -> None:
        """Show the hand at rest; all is compiled by then."""
        self._show(np.zeros(len(self._model.joints)))

    def run(self, is_running: Callable[[], bool]) -> None:
        """Show what comes, until it goes on no more."""
        while is_running():
            start_s = time.perf_counter()
            vector = self._slot.read()
            if vector is not None and vector is not self._vector:
                self._vector = vector
                self._frame(self._unpacked(vector))
            if self._shown is not None:
                newest = self._slot.read()
                self._show_felt(self._shown, self._shown if newest is None else self._unpacked(newest))
            time.sleep(max(0.0, 1 / RATE - (time.perf_counter() - start_s)))

    def _unpacked(self, vector: np.ndarray) -> ViewFrame:
        return ViewFrame.of(vector, len(self._model.joints))

    def _show_felt(self, shown: ViewFrame, newest: ViewFrame) -> None:
        for viewer, notice in zip(self._viewers, self._felt, strict=True):
            notice.update(shown, newest)
            viewer.set_stale(notice.is_stale)
        line = glove_html(shown, self._latency.text())
        if self._felt[1].is_stale and line != self._glove.content:
            self._glove.content = line

    def _frame(self, frame: ViewFrame) -> None:
        self._show(frame.angles)
        trial = TrialState.of(frame.extra)
        self._subject_text.content = subject_html(trial, self._kind)
        self._experimenter_text.content = experimenter_html(trial, self._kind)
        self._torques.content = felt_torques_html(self._model.joints, frame)
        self._shown = frame
        self._latency.record_frame(frame.angles_at)
        self._latency.ask()
        self._glove.content = glove_html(frame, self._latency.text())

    def _show(self, angles: np.ndarray) -> None:
        bodies = self._scene.bodies(angles)
        for viewer in self._viewers:
            viewer.show_bodies(*bodies)
