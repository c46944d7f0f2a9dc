"""The least that the most loaded contact must bear.

With a twist d that contacts see as v_i, sum |P_i(v_i)| max |f_i| is no less than w.d, where P_i projects on cone i:
the bound. A moment counts as the tangential force that uses as much friction.
"""

import jax.numpy as jnp
from jax import Array

from jaxgrasp.numerics import cone_program
from jaxgrasp.numerics.cone_program import ConeProgram, Cones
from jaxgrasp.numerics.vec3 import safe_sqrt
from jaxgrasp.objectives.search import SearchResult
from jaxgrasp.problem.cone_problem import ConeProblem, absent, friction_cones
from jaxgrasp.problem.inequalities import as_cones, limits_of, multipliers
from jaxgrasp.solver.multiplier_bounds import Prices, asked, constraints, push_of, reach, spent


def search(posed: ConeProblem) -> SearchResult:
    inequalities = limits_of(posed, 1)
    cones = [friction_cones(posed, 1), _balls(posed)]
    if inequalities:
        cones.append(as_cones(inequalities))
    size, _, n, c = posed.columns.shape
    equations = jnp.pad(posed.columns.reshape(size, 6, n * c), [(0, 0), (0, 0), (0, 1)])
    last = jnp.zeros((size, n * c + 1), posed.right.dtype).at[:, -1].set(1)
    best = cone_program.solve(ConeProgram(absent(posed, 1), last, equations, posed.right, tuple(cones)))
    bounds = multipliers(inequalities, best.duals[-1]) if inequalities else {}
    y = jnp.where(posed.there[..., None], best.point[:, :-1].reshape(size, n, c), 0)
    prices = Prices(-best.equality, bounds)
    shares = best.duals[1][..., 0]
    return SearchResult(y, _bound(posed, prices), prices, shares, best.missed)


def lagrangian(posed: ConeProblem, found: SearchResult) -> Array:
    """Stationary in forces and multipliers at the optimum, where it is the value."""
    assert found.shares is not None
    return jnp.sum(found.shares * _sizes(posed, found.y), -1) + constraints(posed, found.prices, found.y)


def value(posed: ConeProblem, y: Array) -> Array:
    """Size of the largest force ``(B,)``."""
    return jnp.max(_sizes(posed, y), -1, initial=0)


def _sizes(posed: ConeProblem, y: Array) -> Array:
    """Size of each force ``(B, n)``."""
    lean = posed.friction[..., None] * y[..., 1:]
    return safe_sqrt(y[..., 0] ** 2 + jnp.sum(lean**2, -1))


def _bound(posed: ConeProblem, prices: Prices) -> Array:
    """What no forces stay below ``(B,)``; 0 where nothing is proven."""
    left = asked(posed, prices) - spent(posed, prices)
    able = jnp.sum(reach(posed, push_of(posed, prices)), -1)
    return jnp.where((left > 0) & (able > 0), left / jnp.where(able > 0, able, 1), 0)


def _balls(posed: ConeProblem) -> Cones:
    """|f_i| no larger than the last variable."""
    size, _, n, c = posed.columns.shape
    scale = jnp.concatenate(
        [jnp.ones_like(posed.friction)[..., None], jnp.broadcast_to(posed.friction[..., None], (size, n, c - 1))], -1
    )
    own = jnp.eye(n * c, dtype=posed.right.dtype).reshape(n, c, n * c) * scale[..., None]
    rows = jnp.zeros((size, n, c + 1, n * c + 1), posed.right.dtype)
    rows = rows.at[..., 0, -1].set(-1).at[..., 1:, :-1].set(-own)
    return Cones(rows, jnp.zeros((size, n, c + 1), posed.right.dtype))
