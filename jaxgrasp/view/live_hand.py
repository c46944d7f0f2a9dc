"""Hand whose posture, object and world change while the page runs: its contacts, forces and the object's motion.

All changing values are arguments of two programs, each compiled once: the first solves the static instant, the second
advances the time.
"""

from functools import cache
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxgrasp.grip.monitor import Law
from jaxgrasp.grip.motion import Motion
from jaxgrasp.grip.scene import Scene, at_time
from jaxgrasp.grip.scene_file import GrippedScene
from jaxgrasp.grip.simulation import (
    SimulationState,
    closest_forces,
    initial_state,
    integrate,
    step_and_motion,
    wrench_residual,
)
from jaxgrasp.grip.tick import StepResult, find_touches, observe
from jaxgrasp.hand.kinematics import pose_hand
from jaxgrasp.lab.haptic_loop import Followed
from jaxgrasp.model.arrays import AnyArray
from jaxgrasp.model.hand import HandFrames, Pose, Posture
from jaxgrasp.numerics.compiled_code import jit_here
from jaxgrasp.report.surfaces import pose_matrix
from jaxgrasp.view.live_scene import Controls, LiveScene, counted, scene_with
from jaxgrasp.view.seen import Judged, PosedHand, Seen, judged_by_both, numbers_as_arrays
from jaxgrasp.view.standing_surfaces import moving_poses


class LiveHand(LiveScene):
    """A gripped scene of one object."""

    def __init__(self, made: GrippedScene, law: Law):
        super().__init__(made, law)
        self.others = []
        self._scene = numbers_as_arrays(made.scene)
        self._carried: SimulationState | None = None
        self._before: Posture | None = None

    def look(self, controls: Controls) -> Seen:
        scene = scene_with(self._scene, controls)
        return self._looked(scene, self._posture(controls), self._placed(controls), jnp.zeros(6))

    @property
    def begun(self) -> Followed:
        placed = self.made.placed
        there = Pose(np.asarray(placed.origin)[None], np.asarray(placed.rotation)[None])
        return Followed(there, np.zeros((1, 6)), np.asarray(self.made.scene.contributions, float))

    def follow(self, posture: Posture, followed: Followed) -> Seen:
        own = Pose(followed.placed.origin[0], followed.placed.rotation[0])
        given = (posture, own, followed.wrenches[0], followed.contributions)
        posture, placed, inertial, contributions = jax.tree.map(lambda leaf: jnp.asarray(leaf, float), given)
        scene = eqx.tree_at(lambda s: s.contributions, self._scene, contributions)
        return self._looked(scene, posture, placed, inertial, followed.time)

    def _looked(self, scene: Scene, posture: Posture, placed: Pose, inertial: AnyArray, time: float = 0.0) -> Seen:
        frames, tick, judged = _programs().look(scene, posture, placed, inertial, jnp.asarray(time), law=self.law)
        return self._seen(placed, frames, tick, judged, time)

    def step(self, controls: Controls, dt: float) -> Seen:
        scene, posture = scene_with(self._scene, controls), self._posture(controls)
        carried, before = self._carried, self._before
        if carried is None or before is None:
            carried, before = initial_state(scene, self._placed(controls)), posture
        dt = counted(dt)
        frames, tick, led, judged = _programs().step(scene, dt, carried, before, posture, law=self.law)
        missed = wrench_residual(tick)
        if self.law == "optimum" and bool(tick.slips):
            missed = closest_forces(scene, tick, carried.placed)[1]
        self._carried = integrate(scene, dt, carried, led, missed, tick.assessment.hold, tick.rests)
        self._before = posture
        return self._seen(carried.placed, frames, tick, judged, float(carried.time))

    def start_again(self) -> None:
        self._carried = self._before = None

    def _seen(self, placed: Pose, frames: HandFrames, tick: StepResult, judged: Judged, time: float) -> Seen:
        fetched = jax.device_get((frames.links, placed, tick, judged))
        links, placed, tick, judged = jax.tree.map(np.asarray, fetched)
        return Seen(
            grasp=tick.grasp,
            origin=np.asarray(placed.origin),
            wrench=np.asarray(tick.wrench),
            assessment=tick.assessment,
            **judged._asdict(),
            law=self.law,
            names=self._names,
            object_pose=pose_matrix(placed),
            hand=PosedHand(pose_matrix(links), self.made.scene.hand.joints, np.asarray(tick.torques)),
            rests=bool(tick.rests),
            moving=moving_poses(self.made.scene, time),
        )


class _Programs(NamedTuple):
    look: Any
    step: Any


@cache
def _programs() -> _Programs:
    """Return both programs, compiled for a short compile time, because a person waits for them."""
    return _Programs(jit_here(_look, static_argnames="law"), jit_here(_step, static_argnames="law"))


def _look(
    scene: Scene, posture: Posture, placed: Pose, inertial: AnyArray, time: Array, *, law: Law
) -> tuple[HandFrames, StepResult, Judged]:
    tick = observe(scene, posture, placed, inertial, law=law, time=time)
    return pose_hand(scene.hand, posture), tick, judged_by_both(tick.grasp, tick.assessment)


def _step(
    scene: Scene, dt: Array | float, carried: SimulationState, before: Posture, posture: Posture, *, law: Law
) -> tuple[HandFrames, StepResult, Motion, Judged]:
    """Solve an instant at the posture before, and the object's motion that the change to the new posture requires."""
    now, later = (pose_hand(scene.hand, each) for each in (before, posture))
    scene = at_time(scene, carried.time)
    tick, led = step_and_motion(scene, dt, carried, find_touches(scene, before, carried.placed), now, later, law)
    return now, tick, led, judged_by_both(tick.grasp, tick.assessment)
