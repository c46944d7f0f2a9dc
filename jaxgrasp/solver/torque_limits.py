"""Limits of joint torques: |R f| <= bound, where the rows of R are what the contact forces ask of the joints.

They tie the contacts together, so that no projection of each contact alone can respect them. The dual gets one more
coordinate for each limit, its multiplier, which is a speed (rate) of its joint: with the speeds e contact i moves by
G_i^T x - R_i^T e, and the dual loses the sum of bound |e|. It is not smooth where a speed is zero: a kink, on which
all limits that do not bind stay.
"""

from dataclasses import replace
from typing import NamedTuple

import jax.numpy as jnp
from jax import Array, lax

from jaxgrasp.numerics import vec3
from jaxgrasp.numerics.fused_cpu_kernel import fused_cpu_kernel
from jaxgrasp.numerics.ldl import Lower
from jaxgrasp.numerics.vec3 import Vec3
from jaxgrasp.problem import contact_vec
from jaxgrasp.problem.batch_last import ContactData, ProblemBatch, TorqueBounds
from jaxgrasp.problem.contact_vec import ContactVec
from jaxgrasp.problem.scaling import Scaling
from jaxgrasp.problem.tolerances import tolerances
from jaxgrasp.solver import dual
from jaxgrasp.solver.dual import CandidateForces, DualProblem


class TorqueConstraints(NamedTuple):
    """Limits of a few joints, |map f| <= bound, in scaled units; rows have length 1 in the weights of the contacts."""

    map: ContactVec
    """Components ``(q, n, B)``."""
    bound: Array
    """``(q, B)``; 1 for rows of zeros, which nothing can break."""
    scale: Array
    """``(q, B)``: a row here over the user's."""


@fused_cpu_kernel
def torque_constraints(
    problem: ProblemBatch, data: ContactData, scaling: Scaling, chosen: Array | None = None
) -> TorqueConstraints:
    """Return the limits of the joints ``chosen`` by a 1 in each row ``(B, q, j)``, by default of all joints."""
    constraints, bounds = _in_scaling(problem, data, scaling, chosen)
    square = contact_vec.dot(constraints, constraints)
    # By contacts that can move; where none does, the torque is what it is.
    weighted, unweighted = jnp.sum(data.weights * square, 1), jnp.sum(square, 1)
    size = vec3.safe_sqrt(jnp.where(weighted > 0, weighted, unweighted))
    return _scaled(constraints, bounds, vec3.safe_divide(jnp.ones_like(size), size))


def torque_constraints_scaled_by(
    scale: Array, problem: ProblemBatch, data: ContactData, scaling: Scaling
) -> TorqueConstraints:
    """Return the limits of all joints, with the lengths ``scale`` of their rows."""
    return _scaled(*_in_scaling(problem, data, scaling, None), scale)


def _scaled(constraints: ContactVec, bounds: Array, scale: Array) -> TorqueConstraints:
    return TorqueConstraints(
        contact_vec.scale(scale[:, None], constraints), jnp.where(scale > 0, scale * bounds, 1), scale
    )


def _in_scaling(
    problem: ProblemBatch, data: ContactData, scaling: Scaling, chosen: Array | None
) -> tuple[ContactVec, Array]:
    """Return rows and bounds in a problem's axes and loads; rows of zeros for joints that are not bounded."""
    assert problem.torque_bounds is not None
    maps, bounds = jnp.transpose(problem.torque_bounds.torque_map, (2, 3, 1, 0)), problem.torque_bounds.torque_max.T
    # (c, j, n, B), (j, B)
    is_present, bounded = vec3.dot(data.normals, data.normals) > 0, jnp.isfinite(bounds)
    maps, bounds = jnp.where(is_present & bounded[:, None], maps, 0), jnp.where(bounded, bounds, 0)
    if chosen is not None:
        selected = jnp.transpose(chosen, (1, 2, 0))  # (q, j, B)
        maps = jnp.sum(selected[:, :, None] * maps[:, None], 2)
        bounds = jnp.sum(selected * bounds, 1)
    linear = Vec3(*maps[:3])
    if scaling.axes is not None:
        linear = vec3.rotate(scaling.axes, linear)
    spin = None
    if data.spin_radius is not None:
        spin = scaling.length * data.spin_radius * maps[3] if len(maps) == 4 else 0 * linear.x
    return ContactVec(linear, spin), bounds / scaling.force_unit


def usable(problem: ProblemBatch) -> Array:
    """Return whether the limits of torques are finite and in range ``(B,)``."""
    bounds = problem.torque_bounds
    assert bounds is not None
    is_usable = jnp.sum(jnp.abs(bounds.torque_map), (2, 3)) <= tolerances(bounds.torque_map.dtype).largest
    if problem.present is not None:
        is_usable = is_usable | ~(problem.present > 0.5)
    return jnp.all(is_usable, 1) & jnp.all(bounds.torque_max >= 0, 1)


def cleaned(problem: ProblemBatch) -> ProblemBatch:
    """Return the problem with zeros where its map of torques is not finite."""
    bounds = problem.torque_bounds
    assert bounds is not None
    return replace(
        problem,
        torque_bounds=TorqueBounds(jnp.where(jnp.isfinite(bounds.torque_map), bounds.torque_map, 0), bounds.torque_max),
    )


def torques_of_forces(torque_map: Array, forces: Array, moments: Array | None) -> Array:
    """Return torques ``(B, j)`` by the user's map and forces ``(B, n, 3)``, in the user's units."""
    if torque_map.shape[2] == 4:
        spins = jnp.zeros_like(forces[..., 0]) if moments is None else moments
        forces = jnp.concatenate([forces, spins[..., None]], -1)
    # A product of matrices with one axis to sum over: ten times faster than a sum over two.
    flat = torque_map.reshape(len(torque_map), -1, torque_map.shape[-1])
    return jnp.einsum("bkj,bk->bj", flat, forces.reshape(len(forces), -1), precision=lax.Precision.HIGHEST)


def torques(constraints: TorqueConstraints, forces: ContactVec) -> Array:
    """Return R f ``(q, B)``."""
    return jnp.sum(contact_vec.dot(constraints.map, forces), 1)


def beyond(torque: Array, bound: Array) -> Array:
    """Return the excess of torques over their bounds, with their sign."""
    return jnp.sign(torque) * jnp.maximum(jnp.abs(torque) - bound, 0)


def velocities_by_joints(constraints: TorqueConstraints, rates: Array) -> ContactVec:
    """Return R^T e, the velocities of the contacts by the joints."""
    parts = [jnp.sum(rates[:, None] * c, 0) for c in contact_vec.components(constraints.map)]
    return contact_vec.of_components(parts)


class BorderedMatrix(NamedTuple):
    """A symmetric matrix of the object's coordinates and the rates."""

    plain: Lower
    """The 6x6 block of the object's coordinates."""
    across: Array
    """The block of both ``(6, q, B)``."""
    rate_block: Array
    """The block of the rates ``(q, q, B)``."""


def bordered_hessian(
    problem: DualProblem, constraints: TorqueConstraints, best: CandidateForces, plain: Lower
) -> BorderedMatrix:
    """Return the curvature of the object's coordinates and of the rates."""
    # Blocks of sum of k_i [G_i; -R_i] D_i [G_i; -R_i]^T.
    bent = dual.force_change(problem.data, best, constraints.map)
    wrench = jnp.stack(jnp.broadcast_arrays(*dual.wrench_terms(problem.data, bent)))  # (6, q, n, B)
    pairs = zip(contact_vec.components(constraints.map), contact_vec.components(bent), strict=True)
    # One sum over a stack of both: they share so much work that none should compute it alone.
    sums = jnp.sum(jnp.concatenate([wrench, sum(p[:, None] * q for p, q in pairs)]), 2)
    return BorderedMatrix(plain, -problem.coordinates.wrenches(sums[:6]), sums[6:])


def full_matrix(matrix: BorderedMatrix, keep: Array) -> Array:
    """Assemble a matrix ``(6 + q, 6 + q, B)``, with zeros in rows and columns of rates outside ``keep`` ``(q, B)``."""
    size = range(6)
    corner = jnp.stack([jnp.concatenate([matrix.plain[max(i, j)][min(i, j)] for j in size]) for i in size])
    across = matrix.across * keep
    rate_block = matrix.rate_block * keep * keep[:, None]
    return jnp.concatenate(
        [jnp.concatenate([corner, across], 1), jnp.concatenate([jnp.swapaxes(across, 0, 1), rate_block], 1)]
    )
