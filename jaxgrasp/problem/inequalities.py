"""What limits add to a cone program: inequalities row.x <= end by name, and their multipliers by the same name."""

import jax.numpy as jnp
from jax import Array

from jaxgrasp.numerics.cone_program import Cones
from jaxgrasp.problem.cone_problem import ConeProblem, normal_force_rows

Inequalities = dict[str, tuple[Array, Array]]
"""Rows ``(B, m, k)`` and ends ``(B, m)``; an infinite end is none."""


def limits_of(conic: ConeProblem, extra: int) -> Inequalities:
    """Bounds of normal forces and of torques."""
    size, n = conic.right.shape[0], conic.columns.shape[2]
    rows = jnp.broadcast_to(normal_force_rows(conic, extra), (size, n, conic.width + extra))
    inequalities: Inequalities = {}
    if conic.normal_min is not None:
        inequalities["normal_min"] = -rows, -conic.normal_min
    if conic.normal_max is not None:
        inequalities["normal_max"] = rows, conic.normal_max
    if conic.rows is not None and conic.torque_max is not None:
        torque = jnp.pad(conic.rows.reshape(size, -1, conic.width), [(0, 0), (0, 0), (0, extra)])
        inequalities["up"] = torque, conic.torque_max
        inequalities["down"] = -torque, conic.torque_max
    return inequalities


def as_cones(inequalities: Inequalities) -> Cones:
    """All of them, as cones of one dimension."""
    rows = jnp.concatenate([rows for rows, _ in inequalities.values()], 1)
    ends = jnp.concatenate([ends for _, ends in inequalities.values()], 1)
    holds = jnp.isfinite(ends)
    return Cones(jnp.where(holds[..., None], rows, 0)[:, :, None], jnp.where(holds, ends, 1)[..., None])


def inequality_multipliers(inequalities: Inequalities, duals: Array) -> dict[str, Array]:
    """Return the duals of ``as_cones``, ``(B, m, 1)``, by name ``(B, m)``; zero for infinite bounds."""
    multipliers, first = {}, 0
    for name, (_, ends) in inequalities.items():
        last = first + ends.shape[1]
        multipliers[name] = jnp.where(jnp.isfinite(ends), duals[:, first:last, 0], 0)
        first = last
    return multipliers
