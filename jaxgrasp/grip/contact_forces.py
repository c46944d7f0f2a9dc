"""Contact forces on an object, and their cut to the friction cones where contacts slip."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array, lax

from jaxgrasp.force.slip import spin_force
from jaxgrasp.model.arrays import AnyArray, Bool, Float
from jaxgrasp.model.grasp import Grasp
from jaxgrasp.model.solution import Solution, Verdict
from jaxgrasp.numerics.tiling import beside


class ContactForces(NamedTuple):
    """Forces and moments of contacts on an object."""

    forces: Float[Array, "*batch n 3"]
    """[N]"""
    moments: Float[Array, "*batch n"] | None = None
    """Moments about the normals of soft fingers [N.m]; None where all contacts are hard."""

    def couples(self, grasp: Grasp) -> Float[Array, "*batch n 3"] | None:
        """Return the moments as vectors along the normals; None where all contacts are hard."""
        return None if self.moments is None else self.moments[..., None] * jnp.asarray(grasp.normals)

    def wrench(self, grasp: Grasp) -> Float[Array, "*batch 6"]:
        """Compute the resultant about the frame's origin of the grasp [N, N.m]."""
        return resultant(grasp.points, self.forces, self.couples(grasp))

    def where(self, condition: Bool[Array, "*batch"], alternative: "ContactForces") -> "ContactForces":
        """Select these forces where the condition holds, and ``alternative`` elsewhere."""
        return jax.tree.map(
            lambda leaf, other_leaf: jnp.where(beside(condition, leaf), leaf, other_leaf), self, alternative
        )

    def towards(self, target: "ContactForces", share: Float[Array, "*batch"]) -> "ContactForces":
        """Interpolate linearly to ``target``, by a share from 0 to 1."""
        return jax.tree.map(lambda leaf, other_leaf: leaf + beside(share, leaf) * (other_leaf - leaf), self, target)


def applied_forces(solution: Solution) -> ContactForces:
    """Return a solution's forces and moments as a hand applies them.

    Forces of a failed solution, as of a grasp that slips, have NaN tangents. The hand applies them even then: their
    derivative is set to zero, as of forces that stay constant while the hand moves.
    """
    is_answered = solution.verdict <= Verdict.OUTSIDE_CONES
    applied = ContactForces(solution.forces, solution.moments)
    return applied.where(is_answered, lax.stop_gradient(applied))


def cut_to_cones(grasp: Grasp, exerted: ContactForces) -> ContactForces:
    """Cut forces to those of sliding contacts: friction is limited by eq. 2, and a contact that would have to pull
    exerts nothing (eq. 3). Friction and moment of a soft finger are scaled alike."""
    normals, forces = jnp.asarray(grasp.normals), exerted.forces
    along = jnp.sum(forces * normals, -1)
    across = forces - along[..., None] * normals
    square = jnp.sum(across * across, -1)
    spin = spin_force(grasp, exerted.moments)
    if spin is not None:
        square = square + spin**2
    size = jnp.where(square > 0, jnp.sqrt(jnp.where(square > 0, square, 1)), 0)
    # Eq. 3: f_n >= 0.
    pressed = jnp.maximum(along, 0)
    limit = grasp.friction * pressed
    # Eq. 2: f_t <- f_t min(1, mu f_n / |f_t|), the moment of a soft finger likewise.
    share = jnp.where(size > limit, limit / jnp.where(size > 0, size, 1), 1)
    cut = pressed[..., None] * normals + share[..., None] * across
    return ContactForces(cut, None if exerted.moments is None else share * exerted.moments)


def resultant(
    points: Float[AnyArray, "*batch n 3"],
    forces: Float[AnyArray, "*batch n 3"],
    couples: Float[AnyArray, "*batch n 3"] | None = None,
) -> Float[Array, "*batch 6"]:
    """Compute the wrench of forces at points, and of couples with them, about the points' origin."""
    # w = (sum f, sum p x f + m)
    torque = jnp.cross(jnp.asarray(points), forces)
    if couples is not None:
        torque = torque + couples
    return jnp.concatenate([jnp.sum(forces, -2), jnp.sum(torque, -2)], -1)
