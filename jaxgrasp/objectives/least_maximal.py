"""The least maximal contact force.

With a twist d that contacts see as v_i, sum |P_i(v_i)| max |f_i| >= w.d, where P_i projects on cone i: the bound. A
moment counts as the tangential force that uses as much friction.
"""

import jax.numpy as jnp
from jax import Array

from jaxgrasp.numerics import cone_program
from jaxgrasp.numerics.cone_program import ConeProgram, Cones
from jaxgrasp.numerics.vec3 import safe_sqrt
from jaxgrasp.problem.cone_problem import (
    ConeProblem,
    absent,
    as_cones,
    friction_cones,
    inequality_multipliers,
    limits_of,
)
from jaxgrasp.solver.multiplier_bounds import (
    Multipliers,
    SearchResult,
    constraints,
    contact_power,
    limit_work,
    required_work,
    unit_force_power,
)


def search(conic: ConeProblem) -> SearchResult:
    inequalities = limits_of(conic, 1)
    cones = [friction_cones(conic, 1), _balls(conic)]
    if inequalities:
        cones.append(as_cones(inequalities))
    size, _, n, c = conic.columns.shape
    equations = jnp.pad(conic.columns.reshape(size, 6, n * c), [(0, 0), (0, 0), (0, 1)])
    last = jnp.zeros((size, n * c + 1), conic.right.dtype).at[:, -1].set(1)
    best = cone_program.solve(ConeProgram(absent(conic, 1), last, equations, conic.right, tuple(cones)))
    bounds = inequality_multipliers(inequalities, best.duals[-1]) if inequalities else {}
    y = jnp.where(conic.present[..., None], best.point[:, :-1].reshape(size, n, c), 0)
    multipliers = Multipliers(-best.equality, bounds)
    shares = best.duals[1][..., 0]
    return SearchResult(y, _bound(conic, multipliers), multipliers, shares, best.residual)


def lagrangian(conic: ConeProblem, result: SearchResult) -> Array:
    """Evaluate the Lagrangian, which is stationary in forces and multipliers at the optimum and equal to the value
    there."""
    assert result.shares is not None
    return jnp.sum(result.shares * _sizes(conic, result.y), -1) + constraints(conic, result.multipliers, result.y)


def value(conic: ConeProblem, y: Array) -> Array:
    """Return the size of the largest force ``(B,)``."""
    return jnp.max(_sizes(conic, y), -1, initial=0)


def _sizes(conic: ConeProblem, y: Array) -> Array:
    """Compute the size of each force ``(B, n)``."""
    tangential = conic.friction[..., None] * y[..., 1:]
    return safe_sqrt(y[..., 0] ** 2 + jnp.sum(tangential**2, -1))


def _bound(conic: ConeProblem, multipliers: Multipliers) -> Array:
    """Compute the lower bound of the largest force ``(B,)``; 0 where nothing is proven."""
    bounded_work = required_work(conic, multipliers) - limit_work(conic, multipliers)
    able = jnp.sum(unit_force_power(conic, contact_power(conic, multipliers)), -1)
    return jnp.where((bounded_work > 0) & (able > 0), bounded_work / jnp.where(able > 0, able, 1), 0)


def _balls(conic: ConeProblem) -> Cones:
    """Build the cones |f_i| <= last variable."""
    size, _, n, c = conic.columns.shape
    scale = jnp.concatenate(
        [jnp.ones_like(conic.friction)[..., None], jnp.broadcast_to(conic.friction[..., None], (size, n, c - 1))], -1
    )
    scaled_identity = jnp.eye(n * c, dtype=conic.right.dtype).reshape(n, c, n * c) * scale[..., None]
    rows = jnp.zeros((size, n, c + 1, n * c + 1), conic.right.dtype)
    rows = rows.at[..., 0, -1].set(-1).at[..., 1:, :-1].set(-scaled_identity)
    return Cones(rows, jnp.zeros((size, n, c + 1), conic.right.dtype))
