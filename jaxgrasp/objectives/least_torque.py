"""The least joint torques, by the root of the sum of their squares.

With joint velocities e equal to the torques, and a twist along which no contact can work, w.d - |e|^2 / 2 bounds half
the sum of squares from below.
"""

import jax.numpy as jnp
from jax import Array

from jaxgrasp.numerics import cone_program
from jaxgrasp.numerics.cone_program import ConeProgram
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
)

TIE = 1e-13
"""Weight of the squares of forces beside those of torques: it selects the smallest of forces with equal torques."""
NOTHING = 0.9
"""Half the squares of torques that are rounding, as a power of the machine epsilon."""
REACH = 1e3
"""Factor of the sum of the computed normal forces up to which the bound is proven, where no limit is lower."""


def search(conic: ConeProblem) -> SearchResult:
    assert conic.rows is not None
    inequalities = limits_of(conic, 0)
    size, _, n, c = conic.columns.shape
    rows = conic.rows.reshape(size, -1, n * c)
    price = jnp.maximum(TIE, 10 * jnp.finfo(rows.dtype).eps)
    squares = jnp.einsum("bji,bjk->bik", rows, rows) + absent(conic, 0) + price * jnp.eye(n * c, dtype=rows.dtype)
    cones = [friction_cones(conic, 0)] + ([as_cones(inequalities)] if inequalities else [])
    equations = conic.columns.reshape(size, 6, n * c)
    best = cone_program.solve(ConeProgram(squares, jnp.zeros_like(squares[:, 0]), equations, conic.right, tuple(cones)))
    bounds = inequality_multipliers(inequalities, best.duals[-1]) if inequalities else {}
    y = jnp.where(conic.present[..., None], best.point.reshape(size, n, c), 0)
    multipliers = Multipliers(-best.equality, bounds, _torques(conic, y))
    return SearchResult(y, _bound(conic, multipliers, y[..., 0]), multipliers, None, best.residual)


def _torques(conic: ConeProblem, y: Array) -> Array:
    assert conic.rows is not None
    return jnp.einsum("bjnc,bnc->bj", conic.rows, y)


def value(conic: ConeProblem, y: Array) -> Array:
    return jnp.sqrt(jnp.sum(_torques(conic, y) ** 2, -1))


def _bound(conic: ConeProblem, multipliers: Multipliers, normal_force: Array) -> Array:
    """Compute the lower bound of the torques of forces within the limits and ``REACH`` ``(B,)``."""
    farthest = REACH * jnp.sum(normal_force, -1, keepdims=True)
    if conic.normal_max is not None:
        farthest = jnp.minimum(farthest, conic.normal_max)
    gained = jnp.sum(jnp.maximum(contact_power(conic, multipliers).per_normal_force, 0) * farthest, -1)
    return _root(_half(conic, multipliers) - gained)


def lagrangian(conic: ConeProblem, result: SearchResult) -> Array:
    """Evaluate the Lagrangian, which is stationary in forces and multipliers at the optimum and equal to the value
    there."""
    half = jnp.sum(_torques(conic, result.y) ** 2, -1) / 2
    is_positive = half > float(jnp.finfo(half.dtype).eps) ** NOTHING
    return _root(
        jnp.where(
            is_positive, half + constraints(conic, result.multipliers._replace(objective_rates=None), result.y), 0
        )
    )


def _half(conic: ConeProblem, multipliers: Multipliers) -> Array:
    assert multipliers.objective_rates is not None
    return (
        required_work(conic, multipliers)
        - limit_work(conic, multipliers)
        - jnp.sum(multipliers.objective_rates**2, -1) / 2
    )


def _root(half: Array) -> Array:
    return safe_sqrt(2 * jnp.maximum(half, 0))
