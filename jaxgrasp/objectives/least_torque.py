"""The least joint torques, as the root of the sum of their squares.

With the joints' speeds e = the torques, and a twist along which no contact can work, w.d - |e|^2 / 2 bounds half the
sum of squares.
"""

import jax.numpy as jnp
from jax import Array

from jaxgrasp.numerics import cone_program
from jaxgrasp.numerics.cone_program import ConeProgram
from jaxgrasp.numerics.vec3 import safe_sqrt
from jaxgrasp.objectives.search import SearchResult
from jaxgrasp.problem.cone_problem import ConeProblem, absent, friction_cones
from jaxgrasp.problem.inequalities import as_cones, limits_of, multipliers
from jaxgrasp.solver.multiplier_bounds import Prices, asked, constraints, push_of, spent

TIE = 1e-13
"""Price of the forces' squares beside the torques': it selects the smaller of forces that ask for the same torques."""
NOTHING = 0.9
"""Half the squares of torques that are no more than rounding, as a power of it."""
REACH = 1e3
"""Where no limit bounds a press, the bound is proven up to so many times the sum of presses found."""


def search(posed: ConeProblem) -> SearchResult:
    assert posed.rows is not None
    inequalities = limits_of(posed, 0)
    size, _, n, c = posed.columns.shape
    rows = posed.rows.reshape(size, -1, n * c)
    price = jnp.maximum(TIE, 10 * jnp.finfo(rows.dtype).eps)
    squares = jnp.einsum("bji,bjk->bik", rows, rows) + absent(posed, 0) + price * jnp.eye(n * c, dtype=rows.dtype)
    cones = [friction_cones(posed, 0)] + ([as_cones(inequalities)] if inequalities else [])
    equations = posed.columns.reshape(size, 6, n * c)
    best = cone_program.solve(ConeProgram(squares, jnp.zeros_like(squares[:, 0]), equations, posed.right, tuple(cones)))
    bounds = multipliers(inequalities, best.duals[-1]) if inequalities else {}
    y = jnp.where(posed.there[..., None], best.point.reshape(size, n, c), 0)
    prices = Prices(-best.equality, bounds, _torques(posed, y))
    return SearchResult(y, _bound(posed, prices, y[..., 0]), prices, None, best.missed)


def _torques(posed: ConeProblem, y: Array) -> Array:
    assert posed.rows is not None
    return jnp.einsum("bjnc,bnc->bj", posed.rows, y)


def value(posed: ConeProblem, y: Array) -> Array:
    return jnp.sqrt(jnp.sum(_torques(posed, y) ** 2, -1))


def _bound(posed: ConeProblem, prices: Prices, press: Array) -> Array:
    """What no torques stay below, of forces within the limits and ``REACH`` ``(B,)``."""
    farthest = REACH * jnp.sum(press, -1, keepdims=True)
    if posed.most is not None:
        farthest = jnp.minimum(farthest, posed.most)
    gained = jnp.sum(jnp.maximum(push_of(posed, prices).most, 0) * farthest, -1)
    return _root(_half(posed, prices) - gained)


def lagrangian(posed: ConeProblem, found: SearchResult) -> Array:
    """Stationary in forces and multipliers at the optimum, where it is the value."""
    half = jnp.sum(_torques(posed, found.y) ** 2, -1) / 2
    some = half > float(jnp.finfo(half.dtype).eps) ** NOTHING
    return _root(jnp.where(some, half + constraints(posed, found.prices._replace(drive=None), found.y), 0))


def _half(posed: ConeProblem, prices: Prices) -> Array:
    assert prices.drive is not None
    return asked(posed, prices) - spent(posed, prices) - jnp.sum(prices.drive**2, -1) / 2


def _root(half: Array) -> Array:
    return safe_sqrt(2 * jnp.maximum(half, 0))
