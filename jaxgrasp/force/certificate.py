"""Verification of certificates by arithmetic alone, without the solver that computed them."""

import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxgrasp.model.arguments import check_arguments
from jaxgrasp.model.arrays import AnyArray, Float
from jaxgrasp.model.grasp import Grasp, Limits
from jaxgrasp.numerics import vec3
from jaxgrasp.numerics.vec3 import Vec3
from jaxgrasp.problem import contact_vec, friction_cone, spatial
from jaxgrasp.problem.batch_last import ContactData, ProblemBatch, to_batch_last
from jaxgrasp.problem.contact_vec import ContactVec
from jaxgrasp.problem.flatten import Sharing
from jaxgrasp.problem.scaling import Scaling
from jaxgrasp.solver import torque_limits
from jaxgrasp.solver.dispatch import dispatch


def verify_certificate(
    grasp: Grasp,
    wrench: Float[AnyArray, "*#batch 6"],
    certificate: Float[AnyArray, "*#batch 6"],
    sharing: Sharing = "squeeze",
    *,
    limits: Limits | None = None,
    rates: Float[AnyArray, "*#batch j"] | None = None,
) -> Float[Array, "..."]:
    """Compute the least total force [N] that allowed forces of this wrench need, as a certificate d proves it.

    Allowed forces of w do the work w.d = sum of f_i.v_i along d, with v_i = linear + angular x r_i, and none
    does more than |f_i| times the length of v_i's projection on its cone. So the sum of |f_i| is at least
    w.d over the largest of those lengths.

    With ``limits`` contacts whose normal force is bounded do no more than its bounds let them, which is taken off w.d.
    With limited torques joints may move too, at ``rates`` e: v_i is then less what they move the contact, J_i e, and
    the sum of torque_max |e|, the most that the joints can do, is taken off.

    Args:
        grasp: contacts ``(..., n)``; leading axes broadcast against the wrench's.
        wrench: what the contacts must exert ``(..., 6)`` [N, N.m].
        certificate: d = (linear, angular) about the frame's origin ``(..., 6)``, of any size, such as
            ``Solution.certificate``.
        sharing: as for [`jaxgrasp.closed_form`][]. Contacts of weight zero hold their squeezing force: its
            work is taken off w.d, and it is not counted in the total.
        limits: as for [`jaxgrasp.constrained_optimum`][].
        rates: of the joints ``(..., j)``, such as ``Solution.certificate_rates``; zero where not given.

    Returns:
        The total over the contacts that can move and are not bounded: +inf where no forces at all give the wrench, 0
        where d proves nothing or the data are invalid. Numbers far beyond the load prove that no sensible forces
        give it; rounding alone makes one of an exact proof.

    Raises:
        ValueError: for a sharing that cannot be used, or shapes that do not fit.
    """
    if rates is not None and (limits is None or limits.torque_map is None):
        raise ValueError("rates are given without joint torque limits: expected limits with a torque_map")
    joints = () if limits is None or limits.torque_max is None else np.shape(limits.torque_max)[-1:]
    check_arguments(grasp, {"wrench": (wrench, (6,)), "certificate": (certificate, (6,))}, {"rates": (rates, ("j",))})
    trailing_shapes = (("rates", joints),)
    return dispatch(
        _force_needed,
        grasp,
        wrench,
        sharing,
        limits=limits,
        trailing_shapes=trailing_shapes,
        certificate=certificate,
        rates=rates,
    )


def _force_needed(problem: ProblemBatch, certificate: Array, rates: Array | None = None) -> Array:
    data, valid = to_batch_last(problem)
    if problem.torque_bounds is not None:
        valid = valid & torque_limits.usable(problem)[None]
    if rates is None or problem.torque_bounds is None:
        return jnp.where(valid, _certified_total(data, certificate.T), 0)[0]
    moved, spent = _by_joints(problem, data, rates.T)
    return jnp.where(valid, _certified_total(data, certificate.T, moved, spent), 0)[0]


def _by_joints(problem: ProblemBatch, data: ContactData, rates: Array) -> tuple[ContactVec, Array]:
    """Compute the velocities of the contacts at these joint rates, and the largest power of the joints."""
    assert problem.torque_bounds is not None
    batch_ones = jnp.ones_like(data.force.x)
    # In the user's own frame; joints without a bound have no row, and may not move at all.
    rows = torque_limits.torque_constraints(
        problem, data, Scaling(data.force, batch_ones, batch_ones, batch_ones, batch_ones > 0, batch_ones)
    )
    turned = vec3.safe_divide(rates, rows.scale)
    beyond = jnp.any(
        (rates != 0) & (rows.scale == 0) & ~jnp.isfinite(problem.torque_bounds.torque_max.T), 0, keepdims=True
    )
    spent = jnp.sum(rows.bound * jnp.abs(turned), 0, keepdims=True)
    return torque_limits.velocities_by_joints(rows, turned), jnp.where(beyond, jnp.inf, spent)


def _certified_total(
    data: ContactData, direction: Array, moved: ContactVec | None = None, spent: Array | float = 0.0
) -> Array:
    linear, angular = spatial.parts(direction)
    adjustable = data.weights > 0
    # About the contacts' middle, so that a far frame makes no small difference of large products.
    centre = _middle(data.points, adjustable)
    linear = vec3.add(linear, vec3.cross(angular, centre))
    torque = vec3.sub(data.torque, vec3.cross(centre, data.force))
    spin = None if data.spin_radius is None else data.spin_radius * vec3.dot(angular, data.normals)
    velocity = ContactVec(vec3.add(linear, vec3.cross(angular, vec3.sub(data.points, centre))), spin)
    if moved is not None:
        velocity = contact_vec.sub(velocity, moved)
    endless, bounded = friction_cone.support_function(
        friction_cone.work_per_normal_force(velocity, data.cone), data.cone
    )
    fixed = jnp.where(adjustable, bounded, data.squeeze * vec3.dot(velocity.linear, data.normals))
    work = vec3.dot(data.force, linear) + vec3.dot(torque, angular) - jnp.sum(fixed, 0, keepdims=True) - spent
    cone = friction_cone.Cone(data.normals, data.friction)
    reach = contact_vec.norm(friction_cone.project(velocity, cone, friction_cone.decompose(velocity, cone)))
    largest = jnp.max(jnp.where(adjustable & (endless > 0), reach, 0), 0, keepdims=True)
    need = jnp.where(largest > 0, work / jnp.where(largest > 0, largest, 1), jnp.inf)
    return jnp.where(work > 0, need, 0)


def _middle(points: Vec3, counted: Array) -> Vec3:
    count = jnp.maximum(jnp.sum(counted, 0, keepdims=True), 1).astype(points.x.dtype)
    return Vec3(*(jnp.sum(jnp.where(counted, c, 0), 0, keepdims=True) / count for c in points))
