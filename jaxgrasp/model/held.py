"""Objects in a grip, by the numbers that a person would vary: what a task's grasp and load are made of.

Everything is written in the object's own frame, in which contacts stay where they are while the object moves.
"""

from abc import abstractmethod

import equinox as eqx
import jax.numpy as jnp
from jax import Array

from jaxgrasp.model.arrays import AnyArray, Float
from jaxgrasp.model.grasp import Grasp
from jaxgrasp.model.squeeze import squeezing


class HeldObject(eqx.Module):
    """An object that a hand holds and leads along a path."""

    mass: eqx.AbstractVar[AnyArray | float]
    """[kg]"""
    center_of_mass: eqx.AbstractVar[AnyArray]
    """In the object's frame ``(3,)`` [m]."""

    @abstractmethod
    def grasp(self) -> Grasp:
        """Return the contacts in the object's frame."""

    @abstractmethod
    def moments(self) -> Float[AnyArray, "3 3"]:
        """Moments of inertia about the centre of mass, in the object's axes [kg.m^2]."""


class Held(HeldObject):
    """A rigid object and the contacts that hold it.

    Args:
        points: positions of the contacts in the object's frame ``(n, 3)`` [m].
        normals: directions into the object ``(n, 3)``, of any length.
        friction: Coulomb coefficients ``(n,)`` or one for all [1].
        contributions: shares c of the contacts in eq. 6 ``(n,)`` or one for all [1].
        stiffness: stiffness K of eq. 6 ``(n,)`` or one for all [N/m].
        depths: depths of penetration delta of eq. 6 ``(n,)`` or one for all [m].
        mass: mass of the object [kg].
        center_of_mass: in the object's frame ``(3,)`` [m].
        inertia: moments of inertia about the centre of mass, in the object's axes ``(3, 3)`` [kg.m^2].
    """

    points: Float[AnyArray, "n 3"]
    """Positions of the contacts [m]."""
    normals: Float[AnyArray, "n 3"]
    """Into the object; of any length."""
    friction: Float[AnyArray, "*n"] | float
    """Coulomb coefficients."""
    contributions: Float[AnyArray, "*n"] | float
    """c of eq. 6."""
    stiffness: Float[AnyArray, "*n"] | float
    """K of eq. 6 [N/m]."""
    depths: Float[AnyArray, "*n"] | float
    """delta of eq. 6 [m]."""
    mass: Float[AnyArray, ""] | float
    """[kg]"""
    center_of_mass: Float[AnyArray, "3"]
    """[m]"""
    inertia: Float[AnyArray, "3 3"]
    """About the centre of mass [kg.m^2]."""

    def grasp(self) -> Grasp:
        """Return the contacts, their squeezing forces by eq. 6."""
        return _grasp(self, jnp.asarray(self.points), jnp.asarray(self.normals))

    def moments(self) -> Float[AnyArray, "3 3"]:
        """Moments of inertia about the centre of mass [kg.m^2]."""
        return self.inertia


class HeldCylinder(HeldObject):
    """A solid cylinder about its frame's z axis, held by contacts on its side.

    Args:
        radius: of the cylinder [m].
        length: of the whole cylinder, centred at the origin [m]; only its inertia depends on it.
        azimuths: angles of the contacts about the axis, from x to y ``(n,)`` [rad].
        heights: positions of the contacts along the axis ``(n,)`` [m].
        friction: Coulomb coefficients ``(n,)`` or one for all [1].
        contributions: shares c of the contacts in eq. 6 ``(n,)`` or one for all [1].
        stiffness: stiffness K of eq. 6 ``(n,)`` or one for all [N/m].
        depths: depths of penetration delta of eq. 6 ``(n,)`` or one for all [m].
        mass: mass of the object [kg].
        center_of_mass: in the object's frame ``(3,)`` [m].
    """

    radius: Float[AnyArray, ""] | float
    """[m]"""
    length: Float[AnyArray, ""] | float
    """Length of the whole cylinder, centred at the origin [m]; only its inertia depends on it."""
    azimuths: Float[AnyArray, "n"]
    """Where the contacts are about the axis, from x to y [rad]."""
    heights: Float[AnyArray, "n"]
    """Where they are along the axis [m]."""
    friction: Float[AnyArray, "*n"] | float
    """Coulomb coefficients."""
    contributions: Float[AnyArray, "*n"] | float
    """c of eq. 6."""
    stiffness: Float[AnyArray, "*n"] | float
    """K of eq. 6 [N/m]."""
    depths: Float[AnyArray, "*n"] | float
    """delta of eq. 6 [m]."""
    mass: Float[AnyArray, ""] | float
    """[kg]"""
    center_of_mass: Float[AnyArray, "3"]
    """[m]"""

    def grasp(self) -> Grasp:
        """Return the contacts, their squeezing forces by eq. 6."""
        azimuths, heights = jnp.asarray(self.azimuths), jnp.asarray(self.heights)
        outward = jnp.stack([jnp.cos(azimuths), jnp.sin(azimuths), jnp.zeros_like(azimuths)], -1)
        return _grasp(self, self.radius * outward + heights[:, None] * jnp.array([0.0, 0.0, 1.0]), -outward)

    def moments(self) -> Float[Array, "3 3"]:
        """Moments of inertia about the centre of mass [kg.m^2]."""
        along = self.radius**2 / 2
        across = (3 * self.radius**2 + self.length**2) / 12
        return jnp.diag(jnp.stack([jnp.asarray(self.mass * m) for m in (across, across, along)]))


def _grasp(held: Held | HeldCylinder, points: AnyArray, normals: AnyArray) -> Grasp:
    if not jnp.issubdtype(points.dtype, jnp.floating):
        points = points.astype(float)
    shape = points.shape[:-1]
    squeeze = squeezing(held.contributions, held.stiffness, held.depths)
    friction = jnp.broadcast_to(jnp.asarray(held.friction, points.dtype), shape)
    return Grasp(points, normals, friction, jnp.broadcast_to(squeeze.astype(points.dtype), shape))
