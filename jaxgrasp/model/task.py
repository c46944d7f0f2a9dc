"""Tasks: which grasp must exert which wrench, over time."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array

from jaxgrasp.model.arrays import AnyArray, Float
from jaxgrasp.model.grasp import Grasp
from jaxgrasp.model.hand import Pose
from jaxgrasp.model.held import HeldObject
from jaxgrasp.validation.checked import checked

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
