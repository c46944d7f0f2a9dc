"""The closed form of eqs. 11 and 15 in centred coordinates: a scalar, and a 3x3 system."""

import jax.numpy as jnp
from jax import lax

from jaxgrasp.numerics import ldl
from jaxgrasp.numerics.fused_cpu_kernel import fused_cpu_kernel
from jaxgrasp.numerics.iterate import varying_like
from jaxgrasp.numerics.vec3 import Vec3
from jaxgrasp.problem import contact_vec, spatial
from jaxgrasp.problem.batch_last import squeezing_forces
from jaxgrasp.problem.contact_vec import ContactVec
from jaxgrasp.problem.scaled_problem import ScaledProblem
from jaxgrasp.problem.spatial import SpatialVec
from jaxgrasp.solver import dual
from jaxgrasp.solver.dual import DualProblem


def closed_multiplier(problem: ScaledProblem) -> SpatialVec:
    """Solve G W G^T x = w - G s a for the multiplier that balances the wrench when no cone is imposed (eq. 10)."""
    return _balancing(problem, squeezing_forces(problem.data))


@fused_cpu_kernel
def refined_multiplier(problem: ScaledProblem) -> SpatialVec:
    """``closed_multiplier``, corrected once by what it leaves where a problem is ill-conditioned.

    There the coordinates are whitened, so that the metric is the identity but for rounding.
    """
    data, ill_conditioned = problem.data, problem.ill_conditioned

    def balance(i, multiplier: SpatialVec) -> SpatialVec:
        correction = _balancing(problem, forces_without_cones(problem, multiplier))
        return multiplier + jnp.where((i == 0) | ill_conditioned, correction, 0)

    trips = 1 + jnp.any(ill_conditioned).astype(jnp.int32)
    start = varying_like(jnp.zeros((6, problem.size), data.squeeze.dtype), data, problem.metric)
    return lax.fori_loop(0, trips, balance, start)


def _balancing(problem: ScaledProblem, forces: ContactVec) -> SpatialVec:
    """Return the multiplier that balances the residual of these forces."""
    linear, angular = spatial.parts(dual.residual(problem, forces))
    # (G W G^T)^-1 (w - G f): about the centroid the linear block is the identity.
    return spatial.join(linear, Vec3(*ldl.solve(problem.metric.factors, angular)))


def forces_without_cones(problem: DualProblem, multiplier: SpatialVec) -> ContactVec:
    """Compute the forces of eq. 8 with weights, s a + k G^T x, which friction may not allow."""
    velocity = dual.contact_velocities(problem, multiplier)
    return contact_vec.add(squeezing_forces(problem.data), contact_vec.scale(problem.data.weights, velocity))
