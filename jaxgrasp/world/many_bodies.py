"""World of many bodies: its objects, masses, poses and motions, and the interface of the engines that move them.

An engine returns the state one step later, and the loads that acted on the objects meanwhile. Steady motions are in
NumPy.
"""

from typing import NamedTuple, Protocol, runtime_checkable

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from scipy.spatial.transform import Rotation

from jaxgrasp.grip.motion import Body
from jaxgrasp.grip.scene import Scene, at_time
from jaxgrasp.hand.detection import Contacts
from jaxgrasp.hand.shapes import Shape
from jaxgrasp.model.arrays import AnyArray, Float, Int
from jaxgrasp.model.hand import HandFrames, Pose
from jaxgrasp.model.wrench import weight_wrench
from jaxgrasp.validation.checked import checked


class RigidBody(eqx.Module):
    """An object that is moved by its contacts."""

    body: Body
    friction: float | AnyArray
    """Coulomb's coefficient between the object and the hand."""
    stiffness: float | AnyArray
    """K of eq. 6, between the object and the hand [N/m]."""
    rubbing: float | AnyArray
    """Coulomb's coefficient between the object and the table or another object; of two objects the larger counts."""
    torsion: float | AnyArray | None = None
    """Torsional friction of the hand's contacts with the object [m]; None for hard contacts. All other contacts are
    hard always."""


class World(eqx.Module):
    """A scene, and further objects in it."""

    scene: Scene
    """Hand, gripped object, table, obstacles, gravity and guide."""
    others: tuple[RigidBody, ...] = ()

    @property
    def bodies(self) -> tuple[RigidBody, ...]:
        """Return all objects, the gripped one first."""
        scene = self.scene
        gripped = RigidBody(scene.body, scene.friction, scene.stiffness, scene.table_friction, scene.torsion)
        return (gripped, *self.others)

    @property
    def is_soft(self) -> bool:
        """Return whether the hand's contacts with any object are soft."""
        return any(rigid_body.torsion is not None for rigid_body in self.bodies)

    def at_time(self, time: Float[AnyArray, ""] | float) -> "World":
        """Return the world with its obstacles at their poses and velocities at a time [s]."""
        return World(at_time(self.scene, time), self.others)


class Motions(NamedTuple):
    """Velocities of n bodies in the world: of their centres, and about these."""

    linear: Float[np.ndarray, "n 3"]
    """[m/s]"""
    angular: Float[np.ndarray, "n 3"]
    """[rad/s]"""


class WorldState(NamedTuple):
    """Poses and velocities of the N objects of a world, in its order; NumPy arrays of float64."""

    placed: Pose
    """Poses ``(N,)``."""
    motion: Motions
    """Velocities ``(N, 3)`` each: of the centres, and about them."""
    time: float = 0.0
    """Time at which the paths of obstacles are evaluated [s]."""


class Masses(NamedTuple):
    """Mass and principal moments of inertia of N objects, as NumPy arrays."""

    mass: Float[np.ndarray, "N"]
    """[kg]"""
    moments: Float[np.ndarray, "N 3"]
    """Principal moments about the centres, along their own axes [kg.m^2]."""

    def world_inertia(self, rotation: Float[AnyArray, "N 3 3"]) -> Float[np.ndarray, "N 3 3"]:
        """Return the inertia tensors along the world's axes."""
        return np.einsum("nij,nj,nkj->nik", rotation, self.moments, rotation)

    def momentum(self, state: WorldState) -> Float[np.ndarray, "N 6"]:
        """Return linear momentum, and angular momentum about the centres [N.s, N.m.s]."""
        # p = m v, L = I omega
        angular = np.einsum("nij,nj->ni", self.world_inertia(state.placed.rotation), state.motion.angular)
        return np.concatenate([self.mass[:, None] * state.motion.linear, angular], 1)


def masses(rigid_bodies: tuple[RigidBody, ...]) -> Masses:
    """Collect mass and principal moments of inertia of every object.

    Raises:
        ValueError: for an object with its own inertia tensor, and a mesh that is not in its principal frame.
    """
    for k, rigid_body in enumerate(rigid_bodies):
        if rigid_body.body.inertia is not None:
            raise ValueError(f"object {k} has its own inertia tensor: expected a uniform density among several objects")
    mass = np.array([float(rigid_body.body.mass) for rigid_body in rigid_bodies])
    moments = np.array([_moments(k, rigid_body.body.shape) for k, rigid_body in enumerate(rigid_bodies)])
    return Masses(mass, mass[:, None] * moments)


def holding_weights(world: World) -> Float[np.ndarray, "N 6"]:
    """Return the wrenches that balance the objects' weights, about their centres [N, N.m]."""
    return np.asarray(weight_wrench(masses(world.bodies).mass, jnp.zeros(3), world.scene.gravity))


def _moments(k: int, shape: Shape) -> list[float]:
    moments = [float(np.asarray(moment)) for moment in shape._moments()]
    if not np.all(np.isfinite(moments)):
        raise ValueError(f"object {k} has moments of inertia {moments}: expected a mesh in its principal_frame")
    return moments


@checked
def at_rest(placed: Pose) -> WorldState:
    """Build the state of a world whose objects are at rest.

    Args:
        placed: poses of the objects ``(N,)``, the gripped one first.
    """
    origin, rotation = np.array(placed.origin, float), np.array(placed.rotation, float)
    return WorldState(Pose(origin, rotation), Motions(np.zeros_like(origin), np.zeros_like(origin)))


def link_motion(current: HandFrames, later: HandFrames, dt: float) -> tuple[Pose, Motions]:
    """Return the current poses of a hand's links ``(L,)``, and the steady motion that leads them to their later
    poses."""
    first, last = (np.asarray(frames.links.origin, float) for frames in (current, later))
    start, end = (np.asarray(frames.links.rotation, float) for frames in (current, later))
    turn = Rotation.from_matrix(end @ start.swapaxes(-1, -2)).as_rotvec()
    return Pose(first, start), Motions((last - first) / dt, turn / dt)


def integrate_poses(placed: Pose, motion: Motions, dt: float) -> Pose:
    """Integrate steady motions of bodies ``(n,)`` over ``dt`` seconds; centres move on straight lines."""
    turn = Rotation.from_rotvec(motion.angular * dt).as_matrix()
    return Pose(placed.origin + dt * motion.linear, turn @ placed.rotation)


def velocity_at(motion: Motions, origin: Float[AnyArray, "n 3"], points: Float[np.ndarray, "n 3"]) -> np.ndarray:
    """Compute the velocity ``(n, 3)`` of a point of each body [m/s]."""
    return motion.linear + np.cross(motion.angular, points - origin)


HAND, TABLE, OBSTACLES = -1, -2, -3
"""Codes of bodies in contact that are not objects of the world."""


class HandMove(NamedTuple):
    """Motion of the hand in one step, and its contacts at the start."""

    contacts: Contacts
    """``(N, L)``: contacts of its links with the objects at the start."""
    current: HandFrames
    """Frames of the hand at the start."""
    later: HandFrames
    """Frames at the end; every link moves steadily in between."""


class Loads(NamedTuple):
    """Loads on each of N objects, as wrenches about its centre along the world's axes: means over a step."""

    by_table: Float[np.ndarray, "N 6"]
    """[N, N.m]"""
    by_obstacles: Float[np.ndarray, "N 6"]
    by_bodies: Float[np.ndarray, "N N 6"]
    """On each object (first axis) by each other object."""
    by_hand: Float[np.ndarray, "N 6"]
    """By the hand, in the engine's own contact model."""

    @property
    def by_world(self) -> Float[np.ndarray, "N 6"]:
        """Return the loads by all bodies but the hand."""
        return self.by_table + self.by_obstacles + self.by_bodies.sum(1)


def summed_loads(
    owners: Int[np.ndarray, "m 2"],
    points: Float[np.ndarray, "m 3"],
    forces: Float[np.ndarray, "m 3"],
    centers: Float[AnyArray, "N 3"],
    couples: Float[np.ndarray, "m 3"] | None = None,
) -> Loads:
    """Sum contact forces, and couples with them, into loads on the objects.

    Args:
        owners: index of the object that each force acts on, and of the body that exerts it: an object, which gets the
            opposite force, or HAND, TABLE or OBSTACLES.
        points: points of application [m].
        forces: forces on the first body of each pair [N].
        centers: centres of the objects [m].
        couples: couples on the first body of each pair, where fingers are soft [N.m].
    """
    count = len(centers)
    couples = np.zeros(forces.shape) if couples is None else couples
    total = np.zeros((count, count + 3, 6))
    for sign, (acted_on, source) in ((1.0, owners.T), (-1.0, owners.T[::-1])):
        index = np.flatnonzero(acted_on >= 0)
        pushes = sign * forces[index]
        # (p - c) x f + m
        torques = np.cross(points[index] - centers[acted_on[index]], pushes) + sign * couples[index]
        wrenches = np.concatenate([pushes, torques], 1)
        # Hand, table and obstacles have columns after those of the objects.
        np.add.at(
            total, (acted_on[index], np.where(source[index] < 0, count - 1 - source[index], source[index])), wrenches
        )
    by = {code: total[:, count - 1 - code] for code in (HAND, TABLE, OBSTACLES)}
    return Loads(by[TABLE], by[OBSTACLES], total[:, :count], by[HAND])


class Step(NamedTuple):
    """Result of an engine for one step in time."""

    state: WorldState
    """State after the step."""
    loads: Loads
    gained: Float[np.ndarray, "N 6"]
    """Rate of momentum, linear and angular, of each object [N, N.m]."""
    solved: bool
    """True if the engine solved its own equations to its tolerance."""

    def left_to_hand(self, weights: Float[np.ndarray, "N 6"]) -> Float[np.ndarray, "N 6"]:
        """Return the wrench that the hand must have exerted on each object, given the wrenches that balance their
        weights [N, N.m]."""
        return weights + self.gained - self.loads.by_world


AT_REST = 0.01
"""Length of the step at rest that shows the loads on the hand at the start [s]."""


@runtime_checkable
class Engine(Protocol):
    """Integrator of the objects of one world, which its constructor takes."""

    def step(self, state: WorldState, hand: HandMove, dt: float) -> Step:
        """Move the world by one step.

        Args:
            state: state of all objects at the start.
            hand: motion of the hand in the step, and its contacts.
            dt: length of the step [s].
        """
        ...


def left_at_rest(
    engine: Engine, state: WorldState, contacts: Contacts, frames: HandFrames, weights: Float[np.ndarray, "N 6"]
) -> Float[np.ndarray, "N 6"]:
    """Compute the wrench that a resting hand must exert on each object, beside table and other bodies [N, N.m].

    Args:
        engine: engine of the world.
        state: state of its objects.
        contacts: contacts of the hand with them.
        frames: frames of the hand.
        weights: wrenches that balance the objects' weights.
    """
    return engine.step(state, HandMove(contacts, frames, frames), AT_REST).left_to_hand(weights)
