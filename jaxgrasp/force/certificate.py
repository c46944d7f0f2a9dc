"""What a certificate proves, by arithmetic alone: nothing of the solver that found it is used."""

from functools import partial

import jax
import jax.numpy as jnp
from jax import Array

from jaxgrasp.force import cones, fours, sixes
from jaxgrasp.force.flat import Sharing, flatten, read_sharing, warn_of_lost_precision
from jaxgrasp.force.fours import Four
from jaxgrasp.force.lanes import Lanes, read
from jaxgrasp.model.arrays import AnyArray, Float
from jaxgrasp.model.grasp import Grasp
from jaxgrasp.numerics import vec
from jaxgrasp.numerics.vec import Vec


def verify_certificate(
    grasp: Grasp,
    wrench: Float[AnyArray, "*#batch 6"],
    certificate: Float[AnyArray, "*#batch 6"],
    sharing: Sharing = "squeeze",
) -> Float[Array, "..."]:
    """The least total force that any allowed forces of this wrench need, as a certificate d proves it [N].

    Allowed forces of w do the work w.d = sum of f_i.v_i along d, with v_i = linear + angular x r_i, and none
    does more than |f_i| times the length of v_i's projection on its cone. So the sum of |f_i| is at least
    w.d over the largest of those lengths.

    Args:
        grasp: contacts ``(..., n)``; leading axes broadcast against the wrench's.
        wrench: what the contacts must exert ``(..., 6)`` [N, N.m].
        certificate: d = (linear, angular) about the frame's origin ``(..., 6)``, of any size, such as
            ``Solution.certificate``.
        sharing: as for [`jaxgrasp.closed_form`][]. Contacts of weight zero hold their squeezing force: its
            work is taken off w.d, and it is not counted in the total.

    Returns:
        The total over the contacts that can move: +inf where no forces at all give the wrench, 0 where d
        proves nothing or the data are invalid. Numbers far beyond the load prove that no sensible forces
        give it; rounding alone makes one of an exact proof.

    Raises:
        ValueError: for a sharing that cannot be used, or shapes that do not fit.
    """
    warn_of_lost_precision(grasp, wrench)
    name, weights = read_sharing(sharing)
    return _run(grasp, wrench, certificate, weights, sharing=name)


@partial(jax.jit, static_argnames=("sharing",))
def _run(grasp, wrench, certificate, weights, *, sharing: str) -> Array:
    problem, direction, batch = flatten(grasp, wrench, weights, sharing, certificate=certificate)
    lanes, valid = read(problem)
    assert direction is not None
    return jnp.where(valid, _needed(lanes, direction.T), 0)[0].reshape(batch)


def _needed(lanes: Lanes, direction: Array) -> Array:
    linear, angular = sixes.parts(direction)
    can_move = lanes.weights > 0
    # About the contacts' middle, so that a far frame makes no small difference of large products.
    centre = _middle(lanes.arms, can_move)
    linear = vec.add(linear, vec.cross(angular, centre))
    torque = vec.sub(lanes.torque, vec.cross(centre, lanes.force))
    spin = None if lanes.lever is None else lanes.lever * vec.dot(angular, lanes.normals)
    velocity = Four(vec.add(linear, vec.cross(angular, vec.sub(lanes.arms, centre))), spin)
    fixed = jnp.where(can_move, 0, lanes.squeeze * vec.dot(velocity.linear, lanes.normals))
    work = vec.dot(lanes.force, linear) + vec.dot(torque, angular) - jnp.sum(fixed, 0, keepdims=True)
    sides = cones.split(velocity, lanes.cone)
    reach = fours.norm(cones.project(velocity, lanes.cone, sides))
    largest = jnp.max(jnp.where(can_move, reach, 0), 0, keepdims=True)
    need = jnp.where(largest > 0, work / jnp.where(largest > 0, largest, 1), jnp.inf)
    return jnp.where(work > 0, need, 0)


def _middle(arms: Vec, counted: Array) -> Vec:
    count = jnp.maximum(jnp.sum(counted, 0, keepdims=True), 1)
    return Vec(*(jnp.sum(jnp.where(counted, c, 0), 0, keepdims=True) / count for c in arms))
