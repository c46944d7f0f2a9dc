"""The complete system in virtual time: a hand closes on a cylinder and lifts it, a cable is cut, it is armed again."""

from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxgrasp.glove.model import GloveModel, lrp_hand_master
from jaxgrasp.glove.sensors import nominal_sensors
from jaxgrasp.glove.simulated.simulation import VirtualGlove
from jaxgrasp.grip.monitor import Law
from jaxgrasp.grip.scene import Scene
from jaxgrasp.grip.scene_entries import ObjectEntry
from jaxgrasp.grip.scene_file import GrippedScene, SceneFile, gripped_scene
from jaxgrasp.lab.haptic_loop import HandHaptics, Haptics, pose_at
from jaxgrasp.model.arrays import Float
from jaxgrasp.model.hand import Pose, Posture
from jaxgrasp.validation.checked import checked

COMPUTE = 0.01
"""Time between two ticks of the computing side [s]."""
CLOSE, LIFT, CUT, REARM, END = 0.6, 2.2, 4.0, 5.0, 7.2
"""Times of the events: the hand starts to close, it starts to lift, the line is cut, it is armed again, the end [s]."""
CLOSING, LIFTING, SILENCE = 1.2, 1.2, 0.4
"""Durations of closing, lifting and the cut [s]."""
HEIGHT = 0.1
"""Height to which the wrist is lifted [m]."""
EXTRA_FLEXION = 0.06
"""Flexion beyond the grip that the simulated person aims at, who yields to the glove [rad]."""


@dataclass(frozen=True, eq=False)
class Story:
    """Recorded sequence, at each millisecond for the glove and at each hundredth of a second for the object."""

    times: Float[np.ndarray, "T"]
    """[s]"""
    torques: Float[np.ndarray, "T channels"]
    """Torques at the glove [N.m]."""
    angles: Float[np.ndarray, "T channels"]
    """Angles of the joints [rad]."""
    ticks: Float[np.ndarray, "K"]
    """Times of the computing side [s]."""
    requested: Float[np.ndarray, "K channels"]
    """Torques that the computing side requested [N.m]."""
    heights: Float[np.ndarray, "K"]
    """Height of the object above its start [m]."""
    marks: dict[str, float]
    """Times of the events, by name [s]."""
    torque_summary: dict[str, Any]
    """Torques asked for and given at most [N.m], and for how long each was cut [s]: lists ``asked``, ``given`` and
    ``cut`` by the joints in ``joints``."""


@checked
def cylinder_scene(radius: float = 0.03) -> tuple[Scene, Posture, Pose]:
    """Close a hand on a cylinder of 0.15 kg, which stands on a table; the numbers are choices of this package.

    Args:
        radius: radius of the cylinder [m].
    """
    gripped = gripped_scene(SceneFile(object=ObjectEntry(radius=radius)))
    return gripped.scene, gripped.closed, gripped.placed


@checked
def grasp_and_lift(
    model: GloveModel | None = None,
    law: Law | None = None,
    scene: GrippedScene | None = None,
    haptics: HandHaptics | None = None,
) -> Story:
    """Play the sequence: close, lift, cut, arm again; it takes a minute or two, most of it compiling.

    Args:
        model: model of the glove; the paper's where not given.
        law: force law of the hand, as for [`jaxgrasp.grip.monitor`][]; the scene's where not given.
        scene: hand and object; where not given a cylinder on a table, which slips by the closed form.
        haptics: computation of the torques, such as a world of several objects; that of the scene's object alone
            where not given.
    """
    model = lrp_hand_master() if model is None else model
    gripped = gripped_scene(SceneFile()) if scene is None else scene
    closed, placed, hand = gripped.closed, gripped.placed, gripped.scene.hand
    haptics = haptics or Haptics(gripped.scene, model, np.asarray(closed.angles), placed, law or gripped.law)
    glove = VirtualGlove(model, nominal_sensors(model))
    joint_indices = list(model.joint_indices(hand.joints))
    glove.order(bend=np.asarray(gripped.open)[joint_indices].tolist(), lasts=0.0)
    script = [
        (
            CLOSE,
            lambda: glove.order(
                bend=(np.asarray(closed.angles)[joint_indices] + EXTRA_FLEXION).tolist(), lasts=CLOSING
            ),
        ),
        (CLOSE, lambda: glove.controller.arm(glove.time)),
        (CUT, lambda: glove.order(cut=SILENCE)),
        (REARM, lambda: glove.controller.arm(glove.time)),
    ]
    ticks: list[float] = []
    requested, heights = [], []
    while glove.time < END:
        glove.run(glove.time + COMPUTE)
        state = glove.peer.state
        if state is not None and np.all(np.isfinite(state.angles)):
            rise = HEIGHT * _smooth((glove.time - LIFT) / LIFTING)
            law_of_tick = haptics.tick(glove.time, state.angles, pose_at(jnp.array([0.0, 0.0, rise])))
            glove.peer.latest_law = law_of_tick
            ticks.append(glove.time)
            requested.append(law_of_tick.torques)
            heights.append(float(haptics.followed.placed.origin[0, 2] - placed.origin[2]))
        while script and glove.time >= script[0][0]:
            script.pop(0)[1]()
    times, counts, angles = (np.array(part) for part in zip(*glove.record, strict=True))
    torques = counts[:, : len(model.joints)] * model.quantum
    record = glove.controller.record.summary()
    marks = {"armed, closes": CLOSE, "lifts": LIFT, "cable cut": CUT, "armed again": REARM}
    return Story(times, torques, angles, np.array(ticks), np.array(requested), np.array(heights), marks, record)


def _smooth(share: float) -> float:
    share = min(max(share, 0.0), 1.0)
    return share**3 * (10 - 15 * share + 6 * share**2)
