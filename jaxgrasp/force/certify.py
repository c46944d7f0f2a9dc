"""Proofs that no allowed forces give a wrench.

If w.d > 0 while no contact can push along d, nothing balances w. In floating point a contact may push
along d by rounding; what the direction then proves is that any solution needs at least
(w.d) / (largest push per unit of normal force) of total normal force, and only a need far beyond the load counts.
"""

import jax.numpy as jnp
from jax import Array

from jaxgrasp.force import cones, dual
from jaxgrasp.force.dual import Six
from jaxgrasp.force.lanes import Frame, Lanes, blur
from jaxgrasp.force.tolerances import tolerances
from jaxgrasp.numerics import vec
from jaxgrasp.numerics.vec import Vec


def proves_infeasible(lanes: Lanes, frame: Frame, direction: Six, stretch: Vec) -> Array:
    """Whether ``direction`` (stretched coordinates) shows that the load is out of any sensible force's reach."""
    twist = dual.twist_at(lanes, direction, stretch)
    push = cones.support(twist, lanes.normals, lanes.friction)
    can_move = lanes.weights > 0
    largest = jnp.max(jnp.where(can_move, push, 0), 0, keepdims=True)
    fixed = jnp.where(can_move, 0, lanes.squeeze * vec.dot(twist, lanes.normals))
    work = dual.inner(dual.load(lanes, stretch), direction) - vec.totals(fixed)[0]
    # Written out, the direction loses its last digits, and more of them the further away the frame is.
    linear, angular = dual.parts(direction)
    size = dual.length(dual.six(linear, vec.times(stretch, angular)))
    rounding = 4 * jnp.finfo(work.dtype).eps * size * blur(frame)
    return (work > 0) & (jnp.maximum(largest, rounding) * tolerances(work.dtype).proof <= work)


def proof(lanes: Lanes, frame: Frame, stretch: Vec, rest: Six, run: Six) -> tuple[Array, Six]:
    """Whether what is left of the wrench, or the way the multiplier ran, proves it, and that direction, unstretched.

    Running off, the multiplier keeps its direction's digits where what is left of the wrench loses them.
    """
    by_rest, by_run = (proves_infeasible(lanes, frame, direction, stretch) for direction in (rest, run))
    linear, angular = dual.parts(jnp.where(by_rest, rest, run / jnp.maximum(dual.length(run), 1)))
    return by_rest | by_run, dual.six(linear, vec.times(stretch, angular))


def out_of_range(lanes: Lanes, frame: Frame, stretch: Vec) -> tuple[Array, Six]:
    """Whether torque is asked for about axes that no contact reaches, and that torque as a direction.

    The direction is in unstretched coordinates, where a stretch of zero would hide it.
    """
    zero = jnp.zeros_like(lanes.force.x)
    beyond = Vec(*(jnp.where(s > 0, 0, t) for s, t in zip(stretch, lanes.torque, strict=True)))
    direction = dual.six(Vec(zero, zero, zero), beyond)
    # Loads are of order one here, so this compares with the whole load.
    missed = vec.norm(beyond) > tolerances(zero.dtype).range
    one = jnp.ones_like(zero)
    return missed & proves_infeasible(lanes, frame, direction, Vec(one, one, one)), direction
