"""A hand whose posture, object and world are moved while one looks: what touches, which forces, and what becomes of it.

Everything that changes is an argument of two programs, which are compiled once each: one that looks at things as they
stand, and one that lets time go on.
"""

from functools import cache, partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from scipy.spatial.transform import Rotation

from jaxgrasp.grip.carry import CarryState, closest_to, go_on, led_tick, missed_by, set_down
from jaxgrasp.grip.monitor import Law
from jaxgrasp.grip.motion import Motion
from jaxgrasp.grip.scene import Scene, at_time
from jaxgrasp.grip.scene_file import GrippedScene
from jaxgrasp.grip.tick import Tick, observe, touched
from jaxgrasp.hand.kinematics import pose_hand
from jaxgrasp.lab.haptic_loop import Followed
from jaxgrasp.model.arrays import AnyArray
from jaxgrasp.model.hand import HandFrames, Pose, Posture
from jaxgrasp.numerics.compiled_code import compile_options
from jaxgrasp.report.surfaces import DrawnSurface, pose_matrix
from jaxgrasp.view.seen import Judged, PosedHand, Seen, judged_by_both, numbers_as_arrays
from jaxgrasp.view.standing_surfaces import moving_poses

SHORTEST, LONGEST = 1e-3, 0.05
"""Times that a step counts as at least and at most [s]: a pause does not throw the object."""


class Controls(NamedTuple):
    """What a person sets; at first everything is as the scene has it."""

    angles: np.ndarray
    """Angles of the joints ``(J,)`` [rad]."""
    lift: np.ndarray
    """Way of the wrist ``(3,)`` [m]."""
    turn: float
    """Turn of the wrist about the world's x axis [rad]."""
    place: np.ndarray
    """Way of the object from where it was gripped ``(3,)`` [m]."""
    friction: float
    squeeze: float
    """How many times as hard the hand means to press as by eq. 6."""
    mass: float
    """[kg]"""
    gravity: np.ndarray
    """``(3,)`` [m/s^2]"""


class LiveHand:
    """A gripped scene that follows its controls."""

    def __init__(self, made: GrippedScene, law: Law):
        self.made, self.law = made, law
        self._names = [link.name for link in made.scene.hand.links]
        self._scene = numbers_as_arrays(made.scene)
        self._carried: CarryState | None = None
        self._before: Posture | None = None

    def at_first(self) -> Controls:
        """The scene's own controls."""
        scene, still = self.made.scene, np.zeros(3)
        friction, mass, gravity = (np.asarray(x, float) for x in (scene.friction, scene.body.mass, scene.gravity))
        angles = np.asarray(self.made.closed.angles)
        return Controls(angles, still, 0.0, still, float(friction), 1.0, float(mass), gravity)

    def look(self, controls: Controls) -> Seen:
        """Things as they stand, at rest."""
        return self._looked(self._with(controls), self._posture(controls), self._placed(controls), jnp.zeros(6))

    @property
    def begun(self) -> Followed:
        """The object at first."""
        placed = self.made.placed
        there = Pose(np.asarray(placed.origin)[None], np.asarray(placed.rotation)[None])
        return Followed(there, np.zeros((1, 6)), np.asarray(self.made.scene.contributions, float))

    @property
    def others(self) -> list[DrawnSurface]:
        """No further objects."""
        return []

    def follow(self, posture: Posture, followed: Followed) -> Seen:
        """A hand that others move, and an object that goes with it."""
        own = Pose(followed.placed.origin[0], followed.placed.rotation[0])
        given = (posture, own, followed.wrenches[0], followed.contributions)
        posture, placed, inertial, contributions = jax.tree.map(lambda leaf: jnp.asarray(leaf, float), given)
        scene = eqx.tree_at(lambda s: s.contributions, self._scene, contributions)
        return self._looked(scene, posture, placed, inertial, followed.time)

    def _looked(self, scene: Scene, posture: Posture, placed: Pose, inertial: AnyArray, time: float = 0.0) -> Seen:
        frames, tick, judged = _programs().look(scene, posture, placed, inertial, jnp.asarray(time), law=self.law)
        return self._seen(placed, frames, tick, judged, time)

    def step(self, controls: Controls, dt: float) -> Seen:
        """Let time go on: the object goes where it is carried, slips, rests or falls.

        Args:
            controls: what is set; the object's place counts at the first step alone.
            dt: since the last step [s].
        """
        scene, posture = self._with(controls), self._posture(controls)
        carried, before = self._carried, self._before
        if carried is None or before is None:
            carried, before = set_down(scene, self._placed(controls)), posture
        dt = min(max(dt, SHORTEST), LONGEST)
        frames, tick, led, judged = _programs().step(scene, dt, carried, before, posture, law=self.law)
        missed = missed_by(tick)
        if self.law == "optimum" and bool(tick.slips):
            missed = closest_to(scene, tick, carried.placed)[1]
        self._carried = go_on(scene, dt, carried, led, missed, tick.assessment.hold, tick.rests)
        self._before = posture
        return self._seen(carried.placed, frames, tick, judged, float(carried.time))

    def start_again(self) -> None:
        """The object back to where the controls have it, at rest."""
        self._carried = self._before = None

    def _placed(self, controls: Controls) -> Pose:
        return Pose(self.made.placed.origin + jnp.asarray(controls.place), self.made.placed.rotation)

    def _with(self, controls: Controls) -> Scene:
        """The scene with what is set."""
        where = lambda scene: (scene.friction, scene.stiffness, scene.body.mass, scene.gravity)  # noqa: E731
        stiffness = self._scene.stiffness * controls.squeeze
        new = (controls.friction, stiffness, controls.mass, controls.gravity)
        return eqx.tree_at(where, self._scene, tuple(jnp.asarray(value, float) for value in new))

    def _posture(self, controls: Controls) -> Posture:
        # In NumPy: what is small costs JAX more to call than to compute.
        wrist, turn = self.made.closed.wrist, Rotation.from_euler("x", controls.turn).as_matrix()
        moved = np.asarray(wrist.origin) + controls.lift, turn @ np.asarray(wrist.rotation)
        return Posture(Pose(*map(jnp.asarray, moved)), jnp.asarray(controls.angles, float))

    def _seen(self, placed: Pose, frames: HandFrames, tick: Tick, judged: Judged, time: float) -> Seen:
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
    """Both, compiled in less time than otherwise: a person waits for them."""
    compiled = partial(jax.jit, static_argnames="law", compiler_options=compile_options())
    return _Programs(compiled(_look), compiled(_step))


def _look(
    scene: Scene, posture: Posture, placed: Pose, inertial: AnyArray, time: Array, *, law: Law
) -> tuple[HandFrames, Tick, Judged]:
    tick = observe(scene, posture, placed, inertial, law=law, time=time)
    return pose_hand(scene.hand, posture), tick, judged_by_both(tick.grasp, tick.assessment)


def _step(
    scene: Scene, dt: Array | float, carried: CarryState, before: Posture, posture: Posture, *, law: Law
) -> tuple[HandFrames, Tick, Motion, Judged]:
    """An instant with the hand where it was, and the motion that its way to a posture asks of the object."""
    now, later = (pose_hand(scene.hand, each) for each in (before, posture))
    scene = at_time(scene, carried.time)
    tick, led = led_tick(scene, dt, carried, touched(scene, before, carried.placed), now, later, law)
    return now, tick, led, judged_by_both(tick.grasp, tick.assessment)
