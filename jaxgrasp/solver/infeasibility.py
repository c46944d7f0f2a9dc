"""Proofs that no allowed forces give a wrench.

If w.d > 0 while no contact can push along d, nothing balances w. In floating point a contact may push
along d by rounding; what the direction then proves is that any solution needs at least
(w.d) / (largest push per unit of normal force) of total normal force, and only a need far beyond the load counts.
"""

import jax.numpy as jnp
from jax import Array, lax

from jaxgrasp.numerics import vec3
from jaxgrasp.numerics.fused_cpu_kernel import fused_cpu_kernel
from jaxgrasp.problem import contact_vec, friction_cone, spatial
from jaxgrasp.problem.coordinates import plain_axes
from jaxgrasp.problem.scaled_problem import ScaledProblem
from jaxgrasp.problem.scaling import rounding_growth
from jaxgrasp.problem.tolerances import tolerances
from jaxgrasp.solver import dual, torque_limits
from jaxgrasp.solver.result import Certificate
from jaxgrasp.solver.torque_limits import TorqueConstraints

STATED = 8.0
"""Times the rounding of a direction that is granted to whoever computes anew what it proves."""


def least_normal_force(problem: ScaledProblem, direction: Array, constraints: TorqueConstraints | None = None) -> Array:
    """The total normal force that ``direction`` (in the coordinates) proves to be needed, as of a Certificate.

    With ``constraints``, limits of torques, the rates of their joints stand below the coordinates.
    """
    data = problem.data
    twist = dual.contact_velocities(problem, direction[:6])
    work = spatial.inner(dual.required_wrench(problem), direction[:6])
    size = spatial.length(spatial.join(*problem.coordinates.twist(direction[:6])))
    if constraints is not None:
        rates = direction[6:]
        twist = contact_vec.sub(twist, torque_limits.velocities_by_joints(constraints, rates))
        work = work - jnp.sum(constraints.bound * jnp.abs(rates), 0, keepdims=True)
        size = size + spatial.length(rates)
    push = friction_cone.work_per_normal_force(twist, data.cone)
    can_move = data.weights > 0
    endless, bounded = friction_cone.largest_work(push, data.cone)
    largest = jnp.max(jnp.where(can_move, endless, 0), 0, keepdims=True)
    held = data.squeeze * vec3.dot(twist.linear, data.normals)
    work = work - vec3.totals(jnp.where(can_move, bounded, held))[0]
    # Written out, the direction loses its last digits, and more of them the further away the frame is.
    rounding = 4 * jnp.finfo(work.dtype).eps * size * rounding_growth(problem.scaling)
    proven = (work > 0) & (jnp.maximum(largest, rounding) * tolerances(work.dtype).proof <= work)
    return jnp.where(proven, vec3.safe_divide(work, jnp.maximum(largest, 0) + STATED * rounding), 0)


@fused_cpu_kernel
def find_certificate(
    problem: ScaledProblem, residual: Array, run: Array, constraints: TorqueConstraints | None = None
) -> Certificate:
    """What is left of the wrench, or the way the multiplier ran, whichever proves it, as a twist.

    Running off, the multiplier keeps its direction's digits where what is left of the wrench loses them.
    """
    # What is looked at is what is returned: computed anew, in other kernels, it would be rounded otherwise.
    residual, run = lax.optimization_barrier((residual, run))
    by_rest, by_run = (least_normal_force(problem, direction, constraints) for direction in (residual, run))
    proven = jnp.where(by_rest > 0, residual, run / jnp.maximum(spatial.length(run), 1))
    twist = jnp.concatenate([spatial.join(*problem.coordinates.twist(proven[:6])), proven[6:]])
    return Certificate(twist, jnp.where(by_rest > 0, by_rest, by_run))


@fused_cpu_kernel
def out_of_range(problem: ScaledProblem) -> Certificate:
    """What is asked for along twists that no contact reaches, as a direction, if that is more than rounding.

    The direction is a twist, since the coordinates leave it out.
    """
    plain = problem._replace(coordinates=plain_axes(problem.data.force.x))
    direction = problem.coordinates.unreached(dual.required_wrench(plain))
    # Loads are of order one here, so this compares with the whole load.
    missed = spatial.length(direction) > tolerances(direction.dtype).range
    return Certificate(direction, jnp.where(missed, least_normal_force(plain, direction), 0))
