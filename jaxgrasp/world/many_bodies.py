"""What stays the same in a world of many bodies, and where its objects are."""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from jaxgrasp.grip.motion import Body
from jaxgrasp.grip.scene import Scene, at_time
from jaxgrasp.hand.shapes import Shape
from jaxgrasp.model.arrays import AnyArray, Float
from jaxgrasp.model.hand import Pose
from jaxgrasp.model.wrench import weight_wrench
from jaxgrasp.validation.checked import checked
from jaxgrasp.world.led_bodies import Motions


class Thing(eqx.Module):
    """An object that moves by what touches it."""

    body: Body
    friction: float | AnyArray
    """Coulomb's coefficient between it and the hand."""
    stiffness: float | AnyArray
    """K of eq. 6, between it and the hand [N/m]."""
    rubbing: float | AnyArray
    """Coulomb's coefficient between it and the table or another thing; of two things the larger counts."""
    torsion: float | AnyArray | None = None
    """Torsional friction of the hand's contacts with it [m]; they are hard where not given. Whatever else touches it is
    hard always."""


class World(eqx.Module):
    """A scene, and further objects in it."""

    scene: Scene
    """Hand, gripped object, table, obstacles, gravity and guide."""
    others: tuple[Thing, ...] = ()

    @property
    def things(self) -> tuple[Thing, ...]:
        """All objects, the gripped one first."""
        scene = self.scene
        own = Thing(scene.body, scene.friction, scene.stiffness, scene.table_friction, scene.torsion)
        return (own, *self.others)

    @property
    def is_soft(self) -> bool:
        """Whether the hand's contacts with any object are soft."""
        return any(thing.torsion is not None for thing in self.things)

    def at_time(self, time: Float[AnyArray, ""] | float) -> "World":
        """The world with its obstacles where they are at a time, and as they move [s]."""
        return World(at_time(self.scene, time), self.others)


class WorldState(NamedTuple):
    """Where the N objects of a world are, in its order, and how they move; NumPy arrays of float64."""

    placed: Pose
    """``(N,)``"""
    motion: Motions
    """``(N, 3)`` each: of the centres, and about them."""
    time: float = 0.0
    """At which obstacles are where their paths have them [s]."""


class Masses(NamedTuple):
    """What objects weigh, as NumPy arrays."""

    mass: Float[np.ndarray, "N"]
    """[kg]"""
    moments: Float[np.ndarray, "N 3"]
    """Principal moments about the centres, along their own axes [kg.m^2]."""

    def turned(self, rotation: Float[AnyArray, "N 3 3"]) -> Float[np.ndarray, "N 3 3"]:
        """The moments along the world's axes."""
        return np.einsum("nij,nj,nkj->nik", rotation, self.moments, rotation)

    def momentum(self, state: WorldState) -> Float[np.ndarray, "N 6"]:
        """Linear, and angular about the centres [N.s, N.m.s]."""
        angular = np.einsum("nij,nj->ni", self.turned(state.placed.rotation), state.motion.angular)
        return np.concatenate([self.mass[:, None] * state.motion.linear, angular], 1)


def masses(things: tuple[Thing, ...]) -> Masses:
    """Mass and moments of each.

    Raises:
        ValueError: for an inertia of an object's own, and a mesh whose frame is not that of its principal axes.
    """
    for k, thing in enumerate(things):
        if thing.body.inertia is not None:
            raise ValueError(f"object {k} has an inertia of its own: expected a uniform density among several objects")
    mass = np.array([float(thing.body.mass) for thing in things])
    moments = np.array([_moments(k, thing.body.shape) for k, thing in enumerate(things)])
    return Masses(mass, mass[:, None] * moments)


def holding_weights(world: World) -> Float[np.ndarray, "N 6"]:
    """The wrenches that hold the objects' weights, about their centres [N, N.m]."""
    return np.asarray(weight_wrench(masses(world.things).mass, jnp.zeros(3), world.scene.gravity))


def _moments(k: int, shape: Shape) -> list[float]:
    moments = [float(np.asarray(each)) for each in shape._moments()]
    if not np.all(np.isfinite(moments)):
        raise ValueError(f"object {k} has moments of inertia {moments}: expected a mesh in its principal_frame")
    return moments


@checked
def at_rest(placed: Pose) -> WorldState:
    """A world whose objects do not move yet.

    Args:
        placed: of the objects ``(N,)``, the gripped one first.
    """
    origin, rotation = np.array(placed.origin, float), np.array(placed.rotation, float)
    return WorldState(Pose(origin, rotation), Motions(np.zeros_like(origin), np.zeros_like(origin)))
