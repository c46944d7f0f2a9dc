"""Proofs that no allowed forces give a wrench.

If w.d > 0 while no contact can push along d, nothing balances w. In floating point a contact may push
along d by rounding; what the direction then proves is that any solution needs at least
(w.d) / (largest push per unit of normal force) of total normal force, and only a need far beyond the load counts.
"""

import jax.numpy as jnp
from jax import Array, lax

from jaxgrasp.numerics import ldl, vec3
from jaxgrasp.numerics.fused_cpu_kernel import computed_once, fused_cpu_kernel
from jaxgrasp.numerics.iterate import varying_like
from jaxgrasp.numerics.vec3 import Vec3
from jaxgrasp.problem import contact_vec, friction_cone, spatial
from jaxgrasp.problem.coordinates import add_damping, plain_axes
from jaxgrasp.problem.scaled_problem import ScaledProblem
from jaxgrasp.problem.scaling import rounding_growth
from jaxgrasp.problem.spatial import SpatialVec
from jaxgrasp.problem.tolerances import tolerances
from jaxgrasp.solver import dual, torque_limits
from jaxgrasp.solver.result import Certificate, no_certificate
from jaxgrasp.solver.torque_limits import TorqueConstraints

TURNS = 2
"""Newton steps by which a direction is turned away from contacts that push along it: the digits double with each."""
BEYOND = 0.5
"""Each step aims for pushes below zero by this factor of the largest one; its error shrinks with them."""
VERIFIER_ROUNDING = 8.0
"""Factor on the direction's rounding, taken off what it proves so that a recomputation confirms it."""


def proven_force_bound(problem: ScaledProblem, direction: Array, constraints: TorqueConstraints | None = None) -> Array:
    """Return the total normal force that ``direction`` (in the coordinates) proves to be needed, as in a Certificate.

    With ``constraints``, limits of torques, the rates of their joints stand below the coordinates.
    """
    data = problem.data
    velocity = dual.contact_velocities(problem, direction[:6])
    work = spatial.inner(dual.required_wrench(problem), direction[:6])
    size = spatial.length(spatial.join(*problem.coordinates.twist(direction[:6])))
    if constraints is not None:
        rates = direction[6:]
        velocity = contact_vec.sub(velocity, torque_limits.velocities_by_joints(constraints, rates))
        work = work - jnp.sum(constraints.bound * jnp.abs(rates), 0, keepdims=True)
        size = size + spatial.length(rates)
    push = friction_cone.work_per_normal_force(velocity, data.cone)
    adjustable = data.weights > 0
    endless, bounded = friction_cone.support_function(push, data.cone)
    largest = jnp.max(jnp.where(adjustable, endless, 0), 0, keepdims=True)
    held = data.squeeze * vec3.dot(velocity.linear, data.normals)
    work = work - vec3.totals(jnp.where(adjustable, bounded, held))[0]
    # In the user's frame the direction loses its last digits, more of them the farther the frame is. Friction above 1
    # multiplies what the tangential velocities lose, and so do levers of contacts of little weight, far off. Absent
    # contacts lie anywhere.
    lever = vec3.taxicab(data.points) + (0 if data.spin_radius is None else data.spin_radius)
    lever = jnp.where(adjustable | (data.squeeze > 0), lever, 0)
    grip, reach = (
        jnp.maximum(jnp.max(factor, 0, keepdims=True), 1)
        for factor in (jnp.where(adjustable, data.friction, 0), 0.25 * lever)
    )
    rounding = 4 * jnp.finfo(work.dtype).eps * size * rounding_growth(problem.scaling) * grip * reach
    work = work - rounding * vec3.totals(jnp.where(adjustable, friction_cone.largest_bound(data.cone), data.squeeze))[0]
    proven = (work > 0) & (jnp.maximum(largest, rounding) * tolerances(work.dtype).proof <= work)
    # Sum of the normal forces >= (w.d - bounded work) / max_i h_i(d).
    return jnp.where(proven, vec3.safe_divide(work, jnp.maximum(largest, 0) + VERIFIER_ROUNDING * rounding), 0)


@fused_cpu_kernel
def find_certificate(
    problem: ScaledProblem, residual: Array, displacement: Array, constraints: TorqueConstraints | None = None
) -> Certificate:
    """Return the first proof among three directions, as a twist.

    They are the residual, the multiplier's displacement, and the residual corrected until no contact can push along it.
    A multiplier that runs off keeps its direction's digits where the residual loses them.
    """
    directions = [residual, displacement / jnp.maximum(spatial.length(displacement), 1)]
    if constraints is None:
        directions.append(_turned_away(problem, residual))
    # The barrier keeps XLA from computing the directions again in another kernel, with other rounding.
    candidates = lax.optimization_barrier(jnp.stack(directions))

    def judge(i: Array, certificate: Certificate) -> Certificate:
        direction = candidates[i]
        is_open, force = certificate.force_bound <= 0, proven_force_bound(problem, direction, constraints)
        return Certificate(
            jnp.where(is_open, direction, certificate.direction), jnp.where(is_open, force, certificate.force_bound)
        )

    certificate = lax.fori_loop(0, len(directions), judge, varying_like(no_certificate(residual), candidates, problem))
    linear, angular = problem.coordinates.twist(certificate.direction[:6])
    return certificate._replace(direction=jnp.concatenate([spatial.join(linear, angular), certificate.direction[6:]]))


def _turned_away(problem: ScaledProblem, direction: SpatialVec) -> SpatialVec:
    """Correct a direction by Newton steps until no contact can push along it.

    The residual tends to a direction along which some contacts just do not push; until then they push a little. Mostly
    there are directions beside it along which none pushes at all, and any of them is a proof.
    """
    data = problem.data
    cone = friction_cone.Cone(data.normals, data.friction)
    endless = True if data.normal_max is None else ~jnp.isfinite(data.normal_max)
    adjustable = (data.weights > 0) & endless
    damping = jnp.asarray(jnp.finfo(direction.dtype).eps ** 0.5, direction.dtype)

    def turn(_: Array, direction: SpatialVec) -> SpatialVec:
        split = computed_once(friction_cone.decompose(dual.contact_velocities(problem, direction), cone))
        push = jnp.where(adjustable, split.along + cone.friction * split.size, -jnp.inf)
        largest = jnp.maximum(jnp.max(push, 0, keepdims=True), 0)
        excess = computed_once(jnp.maximum(push + BEYOND * largest, 0))
        strongest = computed_once(friction_cone.edge_force(cone, split))
        # The Hessian of the pushes by the direction has the form of the dual's Hessian.
        along = contact_vec.components(strongest)
        rows = [[jnp.where(excess > 0, along[i] * along[j], 0) for j in range(i + 1)] for i in range(len(along))]
        curvature = add_damping(dual.negative_hessian(problem, rows), problem.metric, damping)
        wrench = vec3.totals(*dual.wrench_terms(data, contact_vec.scale(data.weights * excess, strongest)))
        back = problem.coordinates.wrench(Vec3(*wrench[:3]), Vec3(*wrench[3:]))
        # Newton's step d - H^-1 g on the sum of k_i max(push_i + margin, 0)^2 / 2.
        return direction - dual.solve(ldl.factor(curvature), back)

    return lax.fori_loop(0, TURNS, turn, direction)


@fused_cpu_kernel
def out_of_range(problem: ScaledProblem) -> Certificate:
    """Return the load along twists that no contact reaches, as a direction; a proof where it exceeds rounding.

    The direction is a twist, since the coordinates leave it out.
    """
    plain = problem._replace(coordinates=plain_axes(problem.data.force.x))
    direction = problem.coordinates.unreached(dual.required_wrench(plain))
    # Loads are of order one here, so this compares with the whole load.
    unreachable = spatial.length(direction) > tolerances(direction.dtype).range
    return Certificate(direction, jnp.where(unreachable, proven_force_bound(plain, direction), 0))
