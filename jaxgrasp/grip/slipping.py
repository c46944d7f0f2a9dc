"""What contacts exert that may slip: each at most what its friction allows."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array, lax

from jaxgrasp.force.slip import spin_force
from jaxgrasp.model.arrays import AnyArray, Bool, Float
from jaxgrasp.model.grasp import Grasp
from jaxgrasp.model.solution import Solution, Verdict
from jaxgrasp.numerics.tiling import beside


class Exerted(NamedTuple):
    """What contacts exert on an object."""

    forces: Float[Array, "*batch n 3"]
    """[N]"""
    moments: Float[Array, "*batch n"] | None = None
    """About the normals of soft fingers [N.m]; None where all contacts are hard."""

    def couples(self, grasp: Grasp) -> Float[Array, "*batch n 3"] | None:
        """The moments as vectors; None where all contacts are hard."""
        return None if self.moments is None else self.moments[..., None] * jnp.asarray(grasp.normals)

    def wrench(self, grasp: Grasp) -> Float[Array, "*batch 6"]:
        """Their resultant about the frame's origin of the grasp that they are of [N, N.m]."""
        return resultant(grasp.points, self.forces, self.couples(grasp))

    def where(self, condition: Bool[Array, "*batch"], other: "Exerted") -> "Exerted":
        """These where the condition holds, and others elsewhere."""
        return jax.tree.map(lambda own, its: jnp.where(beside(condition, own), own, its), self, other)

    def towards(self, other: "Exerted", share: Float[Array, "*batch"]) -> "Exerted":
        """A share of the way from these to others."""
        return jax.tree.map(lambda own, its: own + beside(share, own) * (its - own), self, other)


def applied_forces(solution: Solution) -> Exerted:
    """A solution's forces and moments as a hand applies them.

    Where they answer nothing, as of a grasp that slips, they have no derivative. A hand applies something even then:
    they count as those that stay as they are while it moves.
    """
    answers = solution.verdict <= Verdict.OUTSIDE_CONES
    found = Exerted(solution.forces, solution.moments)
    return found.where(answers, lax.stop_gradient(found))


def cut_to_cones(grasp: Grasp, exerted: Exerted) -> Exerted:
    """Forces as sliding leaves them: pressed as hard, dragged by as much as friction holds (eq. 2), and none where a
    contact would have to pull (eq. 3). What a soft finger drags and what it turns fall alike."""
    normals, forces = jnp.asarray(grasp.normals), exerted.forces
    along = jnp.sum(forces * normals, -1)
    across = forces - along[..., None] * normals
    square = jnp.sum(across * across, -1)
    spin = spin_force(grasp, exerted.moments)
    if spin is not None:
        square = square + spin**2
    size = jnp.where(square > 0, jnp.sqrt(jnp.where(square > 0, square, 1)), 0)
    pressed = jnp.maximum(along, 0)
    limit = grasp.friction * pressed
    share = jnp.where(size > limit, limit / jnp.where(size > 0, size, 1), 1)
    cut = pressed[..., None] * normals + share[..., None] * across
    return Exerted(cut, None if exerted.moments is None else share * exerted.moments)


def resultant(
    points: Float[AnyArray, "*batch n 3"],
    forces: Float[AnyArray, "*batch n 3"],
    couples: Float[AnyArray, "*batch n 3"] | None = None,
) -> Float[Array, "*batch 6"]:
    """The wrench of forces at points, and of couples with them, about the points' origin."""
    torque = jnp.cross(jnp.asarray(points), forces)
    if couples is not None:
        torque = torque + couples
    return jnp.concatenate([jnp.sum(forces, -2), jnp.sum(torque, -2)], -1)
