"""Proofs that no allowed forces give a wrench.

If w.d > 0 while no contact can push along d, nothing balances w. In floating point a contact may push
along d by rounding; what the direction then proves is that any solution needs at least
(w.d) / (largest push per unit of normal force) of total normal force, and only a need far beyond the load counts.
"""

import jax.numpy as jnp
from jax import Array

from jaxgrasp.force import cones, dual, sixes
from jaxgrasp.force.lanes import Frame, Lanes, blur
from jaxgrasp.force.sixes import Six
from jaxgrasp.force.tolerances import tolerances
from jaxgrasp.force.unknowns import Unknowns, unstretched
from jaxgrasp.numerics import vec


def proves_infeasible(lanes: Lanes, frame: Frame, direction: Six, unknowns: Unknowns) -> Array:
    """Whether ``direction`` (in the unknowns) shows that the load is out of any sensible force's reach."""
    twist = dual.twist_at(lanes, direction, unknowns)
    push = cones.push(twist, lanes.cone)
    can_move = lanes.weights > 0
    held = lanes.squeeze * vec.dot(twist.linear, lanes.normals)
    endless, bounded = cones.work_of(push, lanes.cone)
    largest = jnp.max(jnp.where(can_move, endless, 0), 0, keepdims=True)
    fixed = jnp.where(can_move, bounded, held)
    work = sixes.inner(dual.load(lanes, unknowns), direction) - vec.totals(fixed)[0]
    # Written out, the direction loses its last digits, and more of them the further away the frame is.
    size = sixes.length(sixes.six(*unknowns.twist(direction)))
    rounding = 4 * jnp.finfo(work.dtype).eps * size * blur(frame)
    return (work > 0) & (jnp.maximum(largest, rounding) * tolerances(work.dtype).proof <= work)


def proof(lanes: Lanes, frame: Frame, unknowns: Unknowns, rest: Six, run: Six) -> tuple[Array, Six]:
    """Whether what is left of the wrench, or the way the multiplier ran, proves it, and that direction as a twist.

    Running off, the multiplier keeps its direction's digits where what is left of the wrench loses them.
    """
    by_rest, by_run = (proves_infeasible(lanes, frame, direction, unknowns) for direction in (rest, run))
    proven = jnp.where(by_rest, rest, run / jnp.maximum(sixes.length(run), 1))
    return by_rest | by_run, sixes.six(*unknowns.twist(proven))


def out_of_range(lanes: Lanes, frame: Frame, unknowns: Unknowns) -> tuple[Array, Six]:
    """Whether something is asked for along twists that no contact reaches, and that as a direction.

    The direction is a twist, since the unknowns leave it out.
    """
    plain = unstretched(lanes.force.x)
    direction = unknowns.unreached(dual.load(lanes, plain))
    # Loads are of order one here, so this compares with the whole load.
    missed = sixes.length(direction) > tolerances(direction.dtype).range
    return missed & proves_infeasible(lanes, frame, direction, plain), direction
