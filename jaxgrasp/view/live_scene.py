"""Live scenes, which change while a page shows them: the interface of all, and a hand with one object in its world.

The world around an object is the table's top below it, where it is near, and obstacles, which may move. All changing
values are arguments of two programs, each compiled once: the first solves the static instant, the second advances the
time.
"""

from abc import ABC, abstractmethod
from functools import cache
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from scipy.spatial.transform import Rotation

from jaxgrasp.grip.monitor import Law
from jaxgrasp.grip.scene import Scene, at_time, obstacles_at_time
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
from jaxgrasp.report.surfaces import DrawnSurface, move_surface, pose_matrix, shape_surface
from jaxgrasp.view.drawing import LawComparison, PosedHand, SolvedGrasp, compare_laws, numbers_as_arrays

NEAR = 0.2
"""Largest distance below an object at which a table is shown [m]."""
EDGE = 0.4
"""Edge of the shown part of the table [m]."""


def standing_surfaces(scene: Scene, at: Pose) -> list[DrawnSurface]:
    """Return the surfaces in the world of table and obstacles that never move.

    Args:
        scene: whose table and obstacles.
        at: where the object is at first.
    """
    surfaces = []
    table = pose_matrix(scene.table)
    middle = (np.asarray(at.origin) - table[:, 3]) @ table[:, :3]
    if 0 <= middle[2] <= NEAR:
        square = np.array([[1.0, 1, 0], [-1, 1, 0], [-1, -1, 0], [1, -1, 0]]) * EDGE / 2 + [middle[0], middle[1], 0]
        surfaces.append(move_surface(DrawnSurface(square, np.array([[0, 1, 2], [0, 2, 3]])), table))
    return surfaces + [
        move_surface(shape_surface(obstacle.shape), pose_matrix(obstacle.placed))
        for obstacle in scene.obstacles
        if obstacle.path is None
    ]


def moving_surfaces(scene: Scene) -> list[DrawnSurface]:
    """Return the surfaces of the obstacles that move, each in its own frame."""
    return [shape_surface(obstacle.shape) for obstacle in scene.obstacles if obstacle.path is not None]


def moving_poses(scene: Scene, time: float) -> np.ndarray:
    """Return the poses ``(M, 3, 4)`` of the moving obstacles at a time [s]."""
    obstacles = obstacles_at_time(scene, time)
    poses = [
        pose_matrix(obstacles[k].placed) for k, obstacle in enumerate(scene.obstacles) if obstacle.path is not None
    ]
    return np.array(poses).reshape(-1, 3, 4)


SHORTEST, LONGEST = 1e-3, 0.05
"""Bounds of the time of a step [s]: a pause does not throw the object."""


class Controls(NamedTuple):
    """Values that a person sets; the initial values are the scene's."""

    angles: np.ndarray
    """Angles of the joints ``(J,)`` [rad]."""
    lift: np.ndarray
    """Way of the wrist ``(3,)`` [m]."""
    turn: float
    """Turn of the wrist about the world's x axis [rad]."""
    shift: np.ndarray
    """Way of the gripped object from where it was gripped ``(3,)`` [m]."""
    friction: float
    """Friction coefficient between the hand and the gripped object."""
    squeeze: float
    """Factor on the intended normal forces of eq. 6."""
    mass: float
    """Mass of the gripped object [kg]."""
    gravity: np.ndarray
    """``(3,)`` [m/s^2]"""


class LiveScene(ABC):
    """A gripped scene that follows its controls, or a hand that others move."""

    other_surfaces: list[DrawnSurface]
    """Further objects, each in its own frame."""

    def __init__(self, gripped: GrippedScene, law: Law):
        self.gripped, self.law = gripped, law
        self._names = [link.name for link in gripped.scene.hand.links]

    def initial_controls(self) -> Controls:
        """Return the controls that reproduce the scene itself."""
        scene, zeros = self.gripped.scene, np.zeros(3)
        friction, mass, gravity = (np.asarray(x, float) for x in (scene.friction, scene.body.mass, scene.gravity))
        angles = np.asarray(self.gripped.closed.angles)
        return Controls(angles, zeros, 0.0, zeros, float(friction), 1.0, float(mass), gravity)

    @property
    @abstractmethod
    def initial_followed(self) -> Followed:
        """Initial state of the objects."""

    @abstractmethod
    def look(self, controls: Controls) -> SolvedGrasp:
        """Solve the grasp at rest, with hand and objects at the poses of the controls."""

    @abstractmethod
    def step(self, controls: Controls, dt: float) -> SolvedGrasp:
        """Let time go on: objects go where they are carried, slip, rest or fall.

        Args:
            controls: what is set; the object's place counts at the first step alone.
            dt: since the last step [s].
        """

    @abstractmethod
    def reset(self) -> None:
        """Move all objects back to their initial poses, the gripped object to that of the controls, at rest."""

    @abstractmethod
    def follow(self, posture: Posture, followed: Followed) -> SolvedGrasp:
        """Solve the grasp of a hand and objects whose motion comes from outside."""

    def _placed(self, controls: Controls) -> Pose:
        """Return the initial pose of the gripped object, displaced by the controls."""
        return Pose(self.gripped.placed.origin + jnp.asarray(controls.shift), self.gripped.placed.rotation)

    def _posture(self, controls: Controls) -> Posture:
        # In NumPy: what is small costs JAX more to call than to compute.
        wrist, turn = self.gripped.closed.wrist, Rotation.from_euler("x", controls.turn).as_matrix()
        pose = np.asarray(wrist.origin) + controls.lift, turn @ np.asarray(wrist.rotation)
        return Posture(Pose(*map(jnp.asarray, pose)), jnp.asarray(controls.angles, float))


def clip_dt(dt: float) -> float:
    """Clip the time of a step [s] to its bounds."""
    return min(max(dt, SHORTEST), LONGEST)


def scene_with(scene: Scene, controls: Controls) -> Scene:
    """Return the scene with the friction, stiffness, mass and gravity of the controls."""
    selected = lambda scene: (scene.friction, scene.stiffness, scene.body.mass, scene.gravity)  # noqa: E731
    values = (controls.friction, scene.stiffness * controls.squeeze, controls.mass, controls.gravity)
    return eqx.tree_at(selected, scene, tuple(jnp.asarray(value, float) for value in values))


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
