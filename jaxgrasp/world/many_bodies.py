"""State of a world of many bodies: its objects, their masses, poses and motions, and steady motions in NumPy."""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from scipy.spatial.transform import Rotation

from jaxgrasp.grip.motion import Body
from jaxgrasp.grip.scene import Scene, at_time
from jaxgrasp.hand.shapes import Shape
from jaxgrasp.model.arrays import AnyArray, Float
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
