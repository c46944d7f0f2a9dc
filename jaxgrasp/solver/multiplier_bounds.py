"""What multipliers prove: bounds of an objective by arithmetic alone, and so its derivatives; result of their search.

A twist d, speeds e of the joints and multipliers of the bounds say how fast each contact would move: no force of
contact i does more work along that than |y_i| times the length of its projection on the contact's cone. Whatever exerts
the wrench does the work w.d, less what the limits let joints and bounds do.
"""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jax import Array

from jaxgrasp.numerics.vec3 import safe_divide, safe_sqrt
from jaxgrasp.problem.batch_last import ProblemBatch
from jaxgrasp.problem.cone_problem import ConeProblem, Units, cone_problem


class Multipliers(NamedTuple):
    """Multipliers, in the units of ``ConeProblem``."""

    twist: Array
    """Multipliers of the wrench, a twist ``(B, 6)``."""
    bounds: dict[str, Array]
    """Multipliers of inequalities, by name; zero or more."""
    objective_rates: Array | None = None
    """Speeds of joints that no limit asks for ``(B, j)``."""


class ContactPower(NamedTuple):
    """Power that a unit force of each contact has at the velocity which the multipliers give it."""

    along: Array
    """That of a unit of normal force ``(B, n)``."""
    across: Array
    """The largest of a unit of friction force over its coefficient ``(B, n)``."""

    @property
    def per_normal_force(self) -> Array:
        """The largest for each unit of normal force, with the friction that it allows."""
        return self.along + self.across


def contact_power(conic: ConeProblem, multipliers: Multipliers) -> ContactPower:
    velocity = velocity_of(conic, multipliers)
    across = safe_sqrt(jnp.sum(velocity[..., 1:] ** 2, -1))
    return ContactPower(velocity[..., 0], across)


def velocity_of(conic: ConeProblem, multipliers: Multipliers) -> Array:
    """Return the velocity that each component of y works against ``(B, n, c)``."""
    velocity = jnp.einsum("bxnc,bx->bnc", conic.columns, multipliers.twist)
    rates = _rates(multipliers)
    if rates is not None and conic.rows is not None:
        velocity = velocity - jnp.einsum("bjnc,bj->bnc", conic.rows, rates)
    along = multipliers.bounds.get("normal_min", 0) - multipliers.bounds.get("normal_max", 0)
    velocity = velocity.at[..., 0].add(along)
    return jnp.where(conic.present[..., None], velocity, 0)


def constraints(conic: ConeProblem, multipliers: Multipliers, y: Array) -> Array:
    """Return the constraint terms of the Lagrangian at forces y ``(B,)``: zero at the optimum, where it is stationary.

    The friction cones are not among them: y is in the same cones whatever the problem.
    """
    work = jnp.sum(y * velocity_of(conic, multipliers), (1, 2))
    return required_work(conic, multipliers) - limit_work(conic, multipliers) - work


def _rates(multipliers: Multipliers) -> Array | None:
    rates = multipliers.objective_rates
    if "up" in multipliers.bounds:
        limited = multipliers.bounds["up"] - multipliers.bounds["down"]
        rates = limited if rates is None else rates + limited
    return rates


def required_work(conic: ConeProblem, multipliers: Multipliers) -> Array:
    """Work that forces of the wrench do at the least, least normal forces taken off ``(B,)``."""
    work = jnp.sum(conic.right * multipliers.twist, -1)
    if conic.normal_min is not None:
        work = work + jnp.sum(multipliers.bounds["normal_min"] * conic.normal_min, -1)
    return work


def limit_work(conic: ConeProblem, multipliers: Multipliers) -> Array:
    """Return the largest work that upper bounds of normal forces and torques allow ``(B,)``."""
    work = jnp.zeros_like(conic.right[:, 0])
    if conic.normal_max is not None:
        work = work + _bound_cost(multipliers.bounds["normal_max"], conic.normal_max)
    if conic.torque_max is not None and "up" in multipliers.bounds:
        work = work + _bound_cost(multipliers.bounds["up"] + multipliers.bounds["down"], conic.torque_max)
    return work


def _bound_cost(price: Array, end: Array) -> Array:
    holds = jnp.isfinite(end)
    return jnp.sum(jnp.where(holds, price * jnp.where(holds, end, 0), 0), -1)


def unit_force_power(conic: ConeProblem, power: ContactPower) -> Array:
    """Largest power of each contact, of forces of size 1 inside its cone ``(B, n)``."""
    slide = safe_divide(power.across, conic.friction)
    inside = (power.along > 0) & (power.across <= conic.friction**2 * power.along)
    # The edge's force of size 1 does (v_a + mu |v_t|) / sqrt(1 + mu^2).
    on_edge = jnp.maximum(power.per_normal_force, 0) / jnp.sqrt(1 + conic.friction**2)
    return jnp.where(inside, safe_sqrt(power.along**2 + slide**2), on_edge)


def with_marginal_friction(problem: ProblemBatch, units: Units, y: Array, multipliers: Multipliers) -> Array:
    """Return the forces with the friction direction that frictionless contacts would use first; for derivatives."""
    slick = (problem.friction == 0)[..., None]
    with_friction = eqx.tree_at(lambda p: p.friction, problem, jnp.where(slick[..., 0], 1, problem.friction))
    across = velocity_of(cone_problem(with_friction, units), multipliers)[..., 1:3]
    press, tail = y[..., :1], y[..., 3:]
    lean = press * safe_divide(across, safe_sqrt(jnp.sum(across**2, -1, keepdims=True)))
    return jnp.concatenate([press, jnp.where(slick, lean, y[..., 1:3]), tail], -1)


class SearchResult(NamedTuple):
    """Forces, their bound and its proof, in the units of ``ConeProblem``."""

    y: Array
    """``(B, n, c)``."""
    bound: Array
    """``(B,)``: value that no forces exceed in quality."""
    multipliers: Multipliers
    """Multipliers that prove the bound, and give the derivative of the value."""
    shares: Array | None
    """``(B, n)``: multipliers of the contacts' shares, for an objective over the largest share; else None."""
    residual: Array
    """``(B,)``: residual of equations and limits."""
