"""What multipliers prove: bounds of an objective by arithmetic alone, and so its derivatives.

A twist d, speeds e of the joints and prices of the bounds say how fast each contact would move: no force of contact i
does more work along that than |y_i| times the length of its projection on the contact's cone. Whatever exerts the
wrench does the work w.d, less what the limits let joints and bounds do.
"""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jax import Array

from jaxgrasp.numerics.vec3 import safe_divide, safe_sqrt
from jaxgrasp.problem.batch_last import ProblemBatch
from jaxgrasp.problem.cone_problem import ConeProblem, Units, cone_problem


class Prices(NamedTuple):
    """Multipliers, in the units of ``ConeProblem``."""

    twist: Array
    """Multipliers of the wrench, a twist ``(B, 6)``."""
    bounds: dict[str, Array]
    """Multipliers of inequalities, by name; zero or more."""
    drive: Array | None = None
    """Speeds of joints that no limit asks for ``(B, j)``."""


class Push(NamedTuple):
    """How contacts would move."""

    along: Array
    """The normal, ``(B, n)``."""
    across: Array
    """Largest power of a unit of lean ``(B, n)``."""

    @property
    def most(self) -> Array:
        """Largest power for each unit of press."""
        return self.along + self.across


def push_of(posed: ConeProblem, prices: Prices) -> Push:
    velocity = velocity_of(posed, prices)
    across = safe_sqrt(jnp.sum(velocity[..., 1:] ** 2, -1))
    return Push(velocity[..., 0], across)


def velocity_of(posed: ConeProblem, prices: Prices) -> Array:
    """What each component of y works against ``(B, n, c)``."""
    velocity = jnp.einsum("bxnc,bx->bnc", posed.columns, prices.twist)
    rates = _rates(prices)
    if rates is not None and posed.rows is not None:
        velocity = velocity - jnp.einsum("bjnc,bj->bnc", posed.rows, rates)
    along = prices.bounds.get("least", 0) - prices.bounds.get("most", 0)
    velocity = velocity.at[..., 0].add(along)
    return jnp.where(posed.there[..., None], velocity, 0)


def constraints(posed: ConeProblem, prices: Prices, y: Array) -> Array:
    """What a Lagrangian adds to the objective of forces y ``(B,)``: nothing at the optimum, where it is stationary.

    The friction cones are not among them: y is in the same cones whatever the problem.
    """
    work = jnp.sum(y * velocity_of(posed, prices), (1, 2))
    return asked(posed, prices) - spent(posed, prices) - work


def _rates(prices: Prices) -> Array | None:
    rates = prices.drive
    if "up" in prices.bounds:
        limited = prices.bounds["up"] - prices.bounds["down"]
        rates = limited if rates is None else rates + limited
    return rates


def asked(posed: ConeProblem, prices: Prices) -> Array:
    """Work that forces of the wrench do at the least, least presses taken off ``(B,)``."""
    work = jnp.sum(posed.right * prices.twist, -1)
    if posed.least is not None:
        work = work + jnp.sum(prices.bounds["least"] * posed.least, -1)
    return work


def spent(posed: ConeProblem, prices: Prices) -> Array:
    """What upper bounds of presses and torques let them do at the most ``(B,)``."""
    given = jnp.zeros_like(posed.right[:, 0])
    if posed.most is not None:
        given = given + _worth(prices.bounds["most"], posed.most)
    if posed.torque_max is not None and "up" in prices.bounds:
        given = given + _worth(prices.bounds["up"] + prices.bounds["down"], posed.torque_max)
    return given


def _worth(price: Array, end: Array) -> Array:
    holds = jnp.isfinite(end)
    return jnp.sum(jnp.where(holds, price * jnp.where(holds, end, 0), 0), -1)


def reach(posed: ConeProblem, push: Push) -> Array:
    """Largest power of each contact, of forces of size 1 inside its cone ``(B, n)``."""
    slide = safe_divide(push.across, posed.friction)
    inside = (push.along > 0) & (push.across <= posed.friction**2 * push.along)
    on_edge = jnp.maximum(push.most, 0) / jnp.sqrt(1 + posed.friction**2)
    return jnp.where(inside, safe_sqrt(push.along**2 + slide**2), on_edge)


def leaning(problem: ProblemBatch, units: Units, y: Array, prices: Prices) -> Array:
    """Forces with the lean that the first friction of a contact without any would be used for."""
    slick = (problem.friction == 0)[..., None]
    rough = eqx.tree_at(lambda p: p.friction, problem, jnp.where(slick[..., 0], 1, problem.friction))
    across = velocity_of(cone_problem(rough, units), prices)[..., 1:3]
    press, rest = y[..., :1], y[..., 3:]
    lean = press * safe_divide(across, safe_sqrt(jnp.sum(across**2, -1, keepdims=True)))
    return jnp.concatenate([press, jnp.where(slick, lean, y[..., 1:3]), rest], -1)
