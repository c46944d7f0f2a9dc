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
from jaxgrasp.grip.scene import Scene, at_time
from jaxgrasp.grip.scene_file import GrippedScene
from jaxgrasp.grip.simulation import (
    ObjectStep,
    SimulationState,
    closest_forces,
    initial_state,
    integrate,
    step_object,
    wrench_residual,
)
from jaxgrasp.grip.tick import StepResult, find_touches, observe
from jaxgrasp.hand.kinematics import pose_hand
from jaxgrasp.lab.haptic_loop import Followed
from jaxgrasp.model.arrays import AnyArray
from jaxgrasp.model.hand import HandFrames, Pose, Posture
from jaxgrasp.numerics.compiled_code import jit_here
from jaxgrasp.report.surfaces import pose_matrix
from jaxgrasp.view.live_scene import Controls, LiveScene, clip_dt, moving_poses, scene_with
from jaxgrasp.view.solved_grasp import LawComparison, PosedHand, SolvedGrasp, compare_laws, numbers_as_arrays


class LiveHand(LiveScene):
    """A gripped scene of one object."""

    def __init__(self, gripped: GrippedScene, law: Law):
        super().__init__(gripped, law)
        self.other_surfaces = []
        self._scene = numbers_as_arrays(gripped.scene)
        self._carried: SimulationState | None = None
        self._previous_posture: Posture | None = None

    def look(self, controls: Controls) -> SolvedGrasp:
        scene = scene_with(self._scene, controls)
        return self._solve_static(scene, self._posture(controls), self._placed(controls), jnp.zeros(6))

    @property
    def initial_followed(self) -> Followed:
        placed = self.gripped.placed
        poses = Pose(np.asarray(placed.origin)[None], np.asarray(placed.rotation)[None])
        return Followed(poses, np.zeros((1, 6)), np.asarray(self.gripped.scene.contributions, float))

    def follow(self, posture: Posture, followed: Followed) -> SolvedGrasp:
        object_pose = Pose(followed.placed.origin[0], followed.placed.rotation[0])
        inputs = (posture, object_pose, followed.wrenches[0], followed.contributions)
        posture, placed, inertial, contributions = jax.tree.map(lambda leaf: jnp.asarray(leaf, float), inputs)
        scene = eqx.tree_at(lambda s: s.contributions, self._scene, contributions)
        return self._solve_static(scene, posture, placed, inertial, followed.time)

    def _solve_static(
        self, scene: Scene, posture: Posture, placed: Pose, inertial: AnyArray, time: float = 0.0
    ) -> SolvedGrasp:
        frames, tick, comparison = _programs().look(scene, posture, placed, inertial, jnp.asarray(time), law=self.law)
        return self._collect(placed, frames, tick, comparison, time)

    def step(self, controls: Controls, dt: float) -> SolvedGrasp:
        scene, posture = scene_with(self._scene, controls), self._posture(controls)
        carried, previous = self._carried, self._previous_posture
        if carried is None or previous is None:
            carried, previous = initial_state(scene, self._placed(controls)), posture
        dt = clip_dt(dt)
        frames, step, comparison = _programs().step(scene, dt, carried, previous, posture, law=self.law)
        tick = step.tick
        residual = wrench_residual(tick)
        if self.law == "optimum" and bool(tick.slips & ~step.is_near):
            residual = closest_forces(scene, tick, carried.placed)[1]
        self._carried = integrate(scene, dt, carried, step, residual)
        self._previous_posture = posture
        return self._collect(carried.placed, frames, tick, comparison, float(carried.time))

    def reset(self) -> None:
        self._carried = self._previous_posture = None

    def _collect(
        self, placed: Pose, frames: HandFrames, tick: StepResult, comparison: LawComparison, time: float
    ) -> SolvedGrasp:
        fetched = jax.device_get((frames.links, placed, tick, comparison))
        links, placed, tick, comparison = jax.tree.map(np.asarray, fetched)
        return SolvedGrasp(
            grasp=tick.grasp,
            origin=np.asarray(placed.origin),
            wrench=np.asarray(tick.wrench),
            assessment=tick.assessment,
            **comparison._asdict(),
            law=self.law,
            names=self._names,
            object_pose=pose_matrix(placed),
            hand=PosedHand(pose_matrix(links), self.gripped.scene.hand.joints, np.asarray(tick.torques)),
            rests=bool(tick.rests),
            moving=moving_poses(self.gripped.scene, time),
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
) -> tuple[HandFrames, StepResult, LawComparison]:
    tick = observe(scene, posture, placed, inertial, law=law, time=time)
    return pose_hand(scene.hand, posture), tick, compare_laws(tick.grasp, tick.assessment)


def _step(
    scene: Scene, dt: Array | float, carried: SimulationState, previous: Posture, posture: Posture, *, law: Law
) -> tuple[HandFrames, ObjectStep, LawComparison]:
    """Solve an instant at the posture before, and the object's motion that the change to the new posture requires."""
    frames, next_frames = (pose_hand(scene.hand, instant) for instant in (previous, posture))
    scene = at_time(scene, carried.time)
    touches = find_touches(scene, previous, carried.placed)
    step = step_object(scene, dt, carried, touches, frames, next_frames, law)
    return frames, step, compare_laws(step.tick.grasp, step.tick.assessment)
