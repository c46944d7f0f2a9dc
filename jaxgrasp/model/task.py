"""Tasks: which grasp must exert which wrench over time, as a hand holds an object and leads it along a path.

Objects in a grip and paths are written by the numbers that a person would vary: they are what a task's grasp and load
are made of. A path is anything that makes a pose of a time; it must have two derivatives, since what leads an object
along it feels its inertia. Grasp and load are written in the object's own frame, in which contacts stay where they are
while the object moves.
"""

from abc import abstractmethod
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike

from jaxgrasp.model.arrays import AnyArray, Float
from jaxgrasp.model.grasp import Grasp
from jaxgrasp.model.hand import Pose
from jaxgrasp.model.squeeze import squeezing
from jaxgrasp.numerics.geometry import rotation_about, unit
from jaxgrasp.validation.checked import checked


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


GRAVITY = (0.0, 0.0, -9.81)
"""[m/s^2]"""


class Task(eqx.Module):
    """time -> (grasp, wrench), together with the parameters that both depend on.

    A task of one's own is a plain function and what it depends on, such as::

        Task({"mass": 0.4, "friction": jnp.full(3, 0.5)}, lambda p, time: (Grasp(...), weight_wrench(p["mass"], ...)))
    """

    parameters: Any
    """Numbers and arrays in dicts, tuples or equinox Modules; they are called by their names in these."""
    at: Callable[[Any, Array], tuple[Grasp, Array]] = eqx.field(static=True)
    """(parameters, time [s]) -> (a Grasp of n contacts, the wrench ``(6,)`` that they must exert), in one frame, which
    may move. Let it be one function for all calls, not made anew for each: it is compiled once."""

    def __call__(self, time: Float[AnyArray, ""] | float) -> tuple[Grasp, Float[Array, "6"]]:
        """Return the grasp and the wrench at a time [s]."""
        instant = jnp.asarray(time)
        is_float = jnp.issubdtype(instant.dtype, jnp.floating)
        return self.at(self.parameters, instant if is_float else instant.astype(float))


class Carried(eqx.Module):
    """The parameters of [`jaxgrasp.grip.carrying`][]."""

    held: HeldObject
    path: Callable[[Array], Pose]
    gravity: Float[AnyArray, "3"]
    """Gravity in the world [m/s^2]."""


@checked
def carrying(held: HeldObject, path: Callable[[Array], Pose], gravity: Float[AnyArray, "3"] | None = None) -> Task:
    """Return the task of leading an object along a path, which balances its weight and its inertia.

    Args:
        held: the object and its contacts: [`jaxgrasp.grip.Held`][], [`jaxgrasp.grip.HeldCylinder`][], or your own.
        path: time [s] -> where the object stands in the world: [`jaxgrasp.grip.Turn`][], [`jaxgrasp.grip.Lift`][],
            [`jaxgrasp.grip.Shake`][], or a Module of one's own. Its accelerations come from its derivatives.
        gravity: in the world ``(3,)`` [m/s^2]; (0, 0, -9.81) where not given.

    Returns:
        A Task in the object's frame, whose parameters are named ``held...``, ``path...`` and ``gravity``.
    """
    return Task(Carried(held, path, jnp.array(GRAVITY) if gravity is None else gravity), carried_at)


def carried_at(carried: Carried, time: Array) -> tuple[Grasp, Array]:
    """Return the grasp, and the wrench that moves the object along its path, in the object's frame."""
    held = carried.held
    placed, rate, change = _two_derivatives(carried.path, time)
    turned, center = placed.rotation.T, jnp.asarray(held.center_of_mass)
    acceleration = change.origin + change.rotation @ center - jnp.asarray(carried.gravity)
    force = held.mass * turned @ acceleration
    # R^T R' is the spin's cross matrix, and of R^T R'' all that is no such matrix is symmetric.
    spin, spinning_up = _axial(turned @ rate.rotation), _axial(turned @ change.rotation)
    moments = held.moments()
    torque = moments @ spinning_up + jnp.cross(spin, moments @ spin)
    return held.grasp(), jnp.concatenate([force, torque + jnp.cross(center, force)])


def _two_derivatives(path: Callable[[Array], Pose], time: Array) -> tuple[Pose, Pose, Pose]:
    """Return a pose with its first and second derivatives by the time."""
    unit = jnp.ones_like(time)
    (placed, rate), (_, change) = jax.jvp(lambda t: jax.jvp(path, (t,), (unit,)), (time,), (unit,))
    return placed, rate, change


def _axial(matrix: AnyArray) -> Array:
    """Return the vector whose cross matrix is the antisymmetric part."""
    m = matrix - matrix.T
    return jnp.stack([m[2, 1], m[0, 2], m[1, 0]]) / 2


class Turn(eqx.Module):
    """Rotation about an axis through the origin, at a steady speed, there and, where it reverses, back again.

    At the instants where it reverses the speed jumps; the blow that this would take is left out.

    Args:
        axis: direction of the axis of rotation ``(3,)``, of any length.
        speed: angular speed [rad/s].
        reversal: time that it goes in one direction before it goes in the other [s]; ``None``: it never reverses.
    """

    axis: Float[AnyArray, "3"]
    """Direction of the axis of rotation, of any length."""
    speed: Float[AnyArray, ""] | float
    """[rad/s]"""
    reversal: Float[AnyArray, ""] | float | None = None
    """How long it goes one way before it goes the other [s]; ``None`` for ever on."""

    def __call__(self, time: Float[AnyArray, ""] | float) -> Pose:
        """Return the pose at a time [s]."""
        along: ArrayLike = time
        if self.reversal is not None:
            phase_time = jnp.mod(time, 2 * self.reversal)
            along = jnp.minimum(phase_time, 2 * self.reversal - phase_time)
        return Pose(jnp.zeros(3), rotation_about(self.axis, self.speed * along))


class Lift(eqx.Module):
    """Straight along a direction, from rest to rest, smoothly.

    Args:
        direction: direction of the lift ``(3,)``, of any length.
        height: distance [m].
        duration: time from rest to rest [s].
    """

    direction: Float[AnyArray, "3"]
    """Direction of the lift, of any length."""
    height: Float[AnyArray, ""] | float
    """How far [m]."""
    duration: Float[AnyArray, ""] | float
    """[s]"""

    def __call__(self, time: Float[AnyArray, ""] | float) -> Pose:
        """Return the pose at a time [s]."""
        height = self.height * smooth_step(jnp.asarray(time) / self.duration)
        return Pose(height * unit(self.direction), jnp.eye(3))


class Shake(eqx.Module):
    """To and fro along a direction, as a sine.

    Args:
        direction: direction of the shaking ``(3,)``, of any length.
        amplitude: largest distance from the middle [m].
        frequency: periods in a second [Hz].
    """

    direction: Float[AnyArray, "3"]
    """Direction of the shaking, of any length."""
    amplitude: Float[AnyArray, ""] | float
    """[m]"""
    frequency: Float[AnyArray, ""] | float
    """[Hz]"""

    def __call__(self, time: Float[AnyArray, ""] | float) -> Pose:
        """Return the pose at a time [s]."""
        displacement = self.amplitude * jnp.sin(2 * jnp.pi * self.frequency * jnp.asarray(time))
        return Pose(displacement * unit(self.direction), jnp.eye(3))


def smooth_step(progress: Array) -> Array:
    """From 0 to 1 without a jump in speed or acceleration."""
    s = jnp.clip(progress, 0, 1)
    return s**3 * (10 - 15 * s + 6 * s**2)
