"""The largest margin from slipping that the worst loaded contact can be left with.

In cones that are narrower by an angle m each, forces within their limits exert so many times the wrench at the most.
That falls with m, and where it falls through 1 is the margin: a root, each look at which is a cone program. Where m
passes the friction angle of a contact, that contact has to be unloaded, and what can be exerted may jump: then that
angle is the margin. Contacts without friction have no margin to lose, and stay.

It may jump elsewhere too: where narrower cones leave the wrench out of reach of forces of any size, what is exerted
falls as a root of the distance does, and then at once to nothing, so that close by no program is solved to a proof.
There the search goes on by another question, whose answer rises in proportion: by how much forces that exert the
wrench have to leave their narrower cones.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array, lax

from jaxgrasp.numerics import cone_program
from jaxgrasp.numerics.cone_program import ConeProgram
from jaxgrasp.numerics.shard_map_loop import varying_like
from jaxgrasp.numerics.tiling import beside, merged, over_chosen
from jaxgrasp.numerics.vec3 import safe_divide, safe_sqrt
from jaxgrasp.objectives.search import SearchResult
from jaxgrasp.problem.cone_problem import ConeProblem, absent, friction_cones
from jaxgrasp.problem.inequalities import Inequalities, as_cones, inequality_multipliers, limits_of
from jaxgrasp.solver.multiplier_bounds import Multipliers, constraints, contact_power, limit_work, required_work

FIRST = 10
"""Looks that are taken for all problems; those that need more are gathered."""
STEPS = 40
LEFT = 8
"""Problems that need more looks are solved so many at a time."""
ENOUGH = 10.0
"""Times the wrench beyond which nothing more is asked for."""
LITTLE = 1e-3
"""Times the wrench below which the slope says nothing about the root."""
OVER = 5
APART_EXPONENT = 0.45
"""How far from the root its two sides are looked at, as an exponent of the machine epsilon [rad]."""
FARTHER = 16
"""Times as far for the next look, where programs close to the root cannot be solved to a proof."""
WHOLE_WRENCH_EXPONENT = 0.5
"""An exponent of the machine epsilon: as near to the whole wrench is all of it, since limits may leave no more room."""
SOUND_EXPONENT = 0.45
"""By how much forces may miss the wrench or their limits, as an exponent of the machine epsilon."""
CLOSE = 4.0
"""Times ``APART_EXPONENT``'s angle: sides of the root that are farther apart are looked for by the second question."""
JUMP = 1e-4
"""More than this beyond the wrench, on the root's near side, is a jump."""
NORMAL_FORCE_CAP = 1e3
"""Loads that a contact presses with at the most where no limit is nearer: with more there is always more margin."""


class _MarginEvaluation(NamedTuple):
    """What cones narrower by some angle exert."""

    times: Array
    """Multiple of the wrench that is exerted by forces that were found ``(B,)``; 1 by the second question."""
    most: Array
    """Multiple of the wrench that no forces exceed."""
    excess: Array
    """How far each force is out of its cone, by the second question, as a normal force; 0 by the first."""
    slope: Array
    """Derivative of that multiple, or of minus the excess, by the angle."""
    y: Array
    multipliers: Multipliers
    residual: Array


def search(conic: ConeProblem) -> SearchResult:
    """Forces of some margin; its bound is that of narrower cones, which were proven not to do."""
    conic = _bounded(conic)
    state = _bracket(conic)
    kept = state.kept
    y = _inside(kept.y) / jnp.where(kept.times > 0, kept.times, 1)[:, None, None]
    # What may be loaded on the near side of a jump and not on its far side.
    angles = _angles(conic)
    passed = (angles >= state.low[:, None]) & (angles <= state.proven[:, None] + _apart(angles))
    jumps = jnp.any(passed, -1) & (kept.times > 1 + JUMP)
    shares = jnp.where(jumps[:, None] & passed, 1 / jnp.maximum(jnp.sum(passed, -1, keepdims=True), 1), 0)
    # Forces of one side and the proof of the other are each other's multipliers, however steep it is between them.
    slope = _slope(conic, _narrowed(conic, state.low), state.beyond, y)
    falls = ~jumps & (slope < 0)
    # The Lagrangian in these units moves as the margin does.
    unit = jnp.where(falls, 1 / jnp.where(falls, slope, -1), 0)
    multipliers = jax.tree.map(lambda x: x * beside(unit, x), state.beyond)
    y = jnp.concatenate([y[..., :1], y[..., 1:] * _shares(conic, state.low)[..., None]], -1)
    return SearchResult(y, state.proven, multipliers, shares, kept.residual)


def value(conic: ConeProblem, y: Array) -> Array:
    """Smallest margin of a loaded contact with friction ``(B,)``."""
    tangential = safe_sqrt(jnp.sum(y[..., 1:] ** 2, -1))
    angles = jnp.arctan(conic.friction)
    left = angles - jnp.arctan2(conic.friction * tangential, jnp.where(tangential > 0, y[..., 0], 1))
    counts = conic.present & (conic.friction > 0) & ((y[..., 0] > 0) | (tangential > 0))
    return jnp.min(jnp.where(counts, left, widest(conic)[:, None]), -1)


def widest(conic: ConeProblem) -> Array:
    """The largest friction angle ``(B,)``, which no margin exceeds."""
    return jnp.max(_angles(conic), -1)


def lagrangian(conic: ConeProblem, found: SearchResult) -> Array:
    """Moves as the margin does with the problem: as the root, or as the friction angle where that is a jump."""
    assert found.shares is not None
    margin = value(lax.stop_gradient(conic), found.y)
    conic = _bounded(conic)
    share = _shares(conic, margin)
    y = jnp.concatenate([found.y[..., :1], safe_divide(found.y[..., 1:], lax.stop_gradient(share)[..., None])], -1)
    rest = constraints(_narrowed(conic, margin), found.multipliers, y)
    return jnp.sum(found.shares * jnp.arctan(conic.friction), -1) + rest


def _bounded(conic: ConeProblem) -> ConeProblem:
    assert conic.normal_max is not None
    return conic._replace(normal_max=jnp.where(conic.present, jnp.minimum(conic.normal_max, NORMAL_FORCE_CAP), jnp.inf))


def _apart(like: Array) -> float:
    return float(jnp.finfo(like.dtype).eps) ** APART_EXPONENT


def _angles(conic: ConeProblem) -> Array:
    """Friction angles of contacts ``(B, n)``; 0 of those that are absent."""
    return jnp.where(conic.present, jnp.arctan(conic.friction), 0)


def _narrowed(conic: ConeProblem, margin: Array) -> ConeProblem:
    """Cones narrower by an angle ``(B,)``; a contact whose own angle is smaller is gone."""
    share = _shares(conic, margin)
    there = conic.present & ((_angles(conic) >= margin[:, None]) | (conic.friction == 0))

    def narrowed(columns: Array) -> Array:
        parts = jnp.concatenate([columns[..., :1], columns[..., 1:] * share[:, None, :, None]], -1)
        return jnp.where(there[:, None, :, None], parts, 0)

    rows = None if conic.rows is None else narrowed(conic.rows)
    return conic._replace(columns=narrowed(conic.columns), friction=share * conic.friction, present=there, rows=rows)


def _shares(conic: ConeProblem, margin: Array) -> Array:
    """Friction that is left over friction ``(B, n)``."""
    left = jnp.tan(jnp.maximum(jnp.arctan(conic.friction) - margin[:, None], 0))
    return safe_divide(left, conic.friction)


def _inside(y: Array) -> Array:
    """In its cones, where rounding may have left forces of next to nothing outside."""
    normal_force = jnp.maximum(y[..., :1], 0)
    tangential = safe_sqrt(jnp.sum(y[..., 1:] ** 2, -1, keepdims=True))
    return jnp.concatenate(
        [normal_force, y[..., 1:] * jnp.where(tangential > normal_force, safe_divide(normal_force, tangential), 1)], -1
    )


def _look(whole: ConeProblem, margin: Array, relaxed: Array) -> _MarginEvaluation:
    """Solve for the largest multiple of the wrench, or where ``relaxed (B,)`` for the least excess at the wrench."""
    conic = _narrowed(whole, margin)
    size, _, n, c = conic.columns.shape
    inequalities = _inequalities(conic, relaxed)
    # The last variable is the multiple, or the excess.
    last = jnp.where(relaxed[:, None], 0, -conic.right)
    equations = jnp.concatenate([conic.columns.reshape(size, 6, n * c), last[..., None]], -1)
    right = jnp.where(relaxed[:, None], conic.right, 0)
    aim = jnp.zeros((size, conic.width + 1), conic.right.dtype).at[:, -1].set(jnp.where(relaxed, 1, -1))
    cones = friction_cones(conic, 1)
    widened = jnp.where(relaxed[:, None] & conic.present, -1, 0)
    cones = cones._replace(rows=cones.rows.at[:, :, 0, -1].set(widened))
    best = cone_program.solve(ConeProgram(absent(conic, 1), aim, equations, right, (cones, as_cones(inequalities))))
    bounds = inequality_multipliers(inequalities, best.duals[-1])
    enough = jnp.where(relaxed, 0, bounds.pop("enough")[:, 0])
    del bounds["positive"]
    multipliers = Multipliers(-best.equality, bounds)
    y = jnp.where(conic.present[..., None], best.point[:, :-1].reshape(size, n, c), 0)
    times, most = jnp.where(relaxed, 1, best.point[:, -1]), _most(conic, multipliers, enough)
    excess = jnp.where(relaxed, best.point[:, -1], 0)
    if conic.normal_min is not None:
        # A contact that is gone cannot press as it must.
        lacking = jnp.any(whole.present & ~conic.present & (conic.normal_min > 0), -1)
        times, most = jnp.where(lacking, 0, times), jnp.where(lacking, 0, most)
    return _MarginEvaluation(times, most, excess, _slope(whole, conic, multipliers, y), y, multipliers, best.residual)


def _slope(whole: ConeProblem, conic: ConeProblem, multipliers: Multipliers, y: Array) -> Array:
    """How what is exerted changes with the angle ``(B,)``: as friction that pays does."""
    # Of tan: what a radian takes off the friction that is left, as a part of it.
    shrinks = -safe_divide(1 + conic.friction**2, conic.friction)
    pays = y[..., 0] * contact_power(conic, multipliers).across
    return jnp.sum(jnp.where(conic.present & (whole.friction > 0), pays * shrinks, 0), -1)


def _inequalities(conic: ConeProblem, relaxed: Array) -> Inequalities:
    """Limits; least normal forces, like the wrench, as many times as they are exerted. An excess is not negative."""
    found = limits_of(conic, 1)
    if conic.normal_min is not None:
        rows, ends = found["normal_min"]
        fixed = relaxed[:, None]
        rows = rows.at[..., -1].set(jnp.where(fixed, 0, conic.normal_min))
        found["normal_min"] = rows, jnp.where(fixed, ends, 0)
    last = jnp.zeros((conic.right.shape[0], 1, conic.width + 1), conic.right.dtype).at[..., -1].set(1)
    found["enough"] = last, jnp.where(relaxed[:, None], jnp.inf, jnp.full_like(conic.right[:, :1], ENOUGH))
    found["positive"] = -last, jnp.where(relaxed[:, None], 0, jnp.full_like(conic.right[:, :1], jnp.inf))
    return found


def _most(conic: ConeProblem, multipliers: Multipliers, enough: Array) -> Array:
    """What the multipliers prove, those of largest normal forces raised until no contact works along them ``(B,)``."""
    assert conic.normal_max is not None
    push = jnp.maximum(contact_power(conic, multipliers).per_normal_force, 0)
    raised = jnp.sum(jnp.where(push > 0, push * conic.normal_max, 0), -1)
    given = limit_work(conic, multipliers) + ENOUGH * enough + raised
    worth = required_work(conic, multipliers) + enough
    return jnp.where(worth > 0, given / jnp.where(worth > 0, worth, 1), jnp.inf)


class _State(NamedTuple):
    angles: Array
    """Friction angles ``(B, n)``: where what can be exerted may jump; beyond the widest no contact is left."""
    low: Array
    """The largest angle that is known to leave the wrench in reach; 0 to begin with."""
    high: Array
    """The smallest that is known not to."""
    proven: Array
    """The smallest that is proven not to."""
    relaxed: Array
    """Whether the second question is asked."""
    here: Array
    """Where to look next."""
    root: Array
    """Where the search ended."""
    phase: Array
    """0 in search of the root; then 1 for a look at its near side, and the others for those at its far side."""
    kept: _MarginEvaluation
    """What was seen at ``low``."""
    beyond: Multipliers
    """The proof at ``proven``, where one was seen."""


def _bracket(conic: ConeProblem) -> _State:
    """Two angles a little apart, between which the wrench gets out of reach, and what was seen at the smaller."""
    whole = widest(conic)
    zero = 0 * whole
    nothing = jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), jax.eval_shape(_look, conic, zero, zero > 0))
    phase = zero.astype(jnp.int32)
    start = _State(_angles(conic), zero, whole, whole, zero > 0, zero, zero, phase, nothing, nothing.multipliers)

    state = _looked(conic, start, FIRST)
    return over_chosen(partial(_looked, count=STEPS), conic, state, state.phase < OVER, LEFT)


def _looked(conic: ConeProblem, state: _State, count: int) -> _State:
    """After so many more looks, where there are so many to take."""

    def step(carry):
        done, state = carry
        moved = _step(state, _look(conic, state.here, state.relaxed))
        return done + 1, merged(state.phase == OVER, state, moved)

    state = varying_like(state, conic)
    return lax.while_loop(lambda c: (c[0] < count) & ~jnp.all(c[1].phase == OVER), step, (jnp.int32(0), state))[1]


def _halved(angles: Array, low: Array, high: Array) -> Array:
    """Somewhere between: where there may be a jump; behind one that may have been found; else in the middle."""
    middle, apart = (low + high) / 2, _apart(low)
    between = (angles > low[:, None]) & (angles < high[:, None])
    far = jnp.where(between, jnp.abs(angles - middle[:, None]), jnp.inf)
    nearest = jnp.take_along_axis(angles, jnp.argmin(far, -1)[:, None], -1)[:, 0]
    behind = jnp.any(angles == low[:, None], -1) & (low > 0) & (high > low + apart)
    return jnp.where(behind, low + apart / 2, jnp.where(jnp.any(between, -1), nearest, middle))


def _step(state: _State, seen: _MarginEvaluation) -> _State:
    """Newton's step for the logarithm, which is nearly straight over most of the way; halves where that leads out.

    An excess is itself nearly straight, beyond the root; before it, it is 0.
    """
    apart = _apart(state.here)
    eps = float(jnp.finfo(state.here.dtype).eps)
    whole = (seen.times >= 1 - eps**WHOLE_WRENCH_EXPONENT) & (seen.excess <= eps**WHOLE_WRENCH_EXPONENT)
    holds = whole & (seen.residual <= eps**SOUND_EXPONENT)
    best = holds & (state.here >= state.low)
    low = jnp.where(best, state.here, state.low)
    high = jnp.where(holds, state.high, jnp.minimum(state.here, state.high))
    proves = (seen.most < 1 - eps**WHOLE_WRENCH_EXPONENT) & (state.here <= state.proven)
    proven = jnp.where(proves, state.here, state.proven)
    falls = (seen.times > LITTLE) & (seen.slope < 0) & (~state.relaxed | ~whole)
    rate = jnp.where(falls, seen.slope, -1) / jnp.where(falls, seen.times, 1)
    # Times is 1 where an excess is asked for, and the excess 0 where it is not.
    led = state.here + (seen.excess - jnp.log(jnp.where(falls, seen.times, 1))) / rate
    inside = falls & (led > low) & (led < high)
    near = falls & (jnp.abs(led - state.here) <= apart / 4)
    there = jnp.where(near, state.here, jnp.where(inside, led, _halved(state.angles, low, high)))
    # Where whole cones barely do, or the root is that of the widest, there is nothing between.
    arrived = (state.phase == 0) & (near | (high - low <= apart))
    root = jnp.where(arrived, there, state.root)
    phase = jnp.where((state.phase > 0) | arrived, state.phase + 1, 0)
    phase = jnp.where((phase > 2) & (proven <= root + apart), OVER, phase)
    far = apart * FARTHER ** (phase - 2).astype(root.dtype)
    sides = jnp.where(phase == 1, jnp.maximum(root - apart, low), jnp.minimum(root + far, jnp.max(state.angles, -1)))
    here = jnp.where(phase == 0, there, sides)
    kept, beyond = merged(best, seen, state.kept), merged(proves, seen.multipliers, state.beyond)
    # The second question begins beyond the root, from where the excess leads to it.
    again = (phase == OVER) & ~state.relaxed & (proven - low > CLOSE * apart)
    phase, here, high = (jnp.where(again, new, old) for new, old in ((0, phase), (proven, here), (proven, high)))
    proven = jnp.maximum(proven, low)
    return _State(state.angles, low, high, proven, state.relaxed | again, here, root, phase, kept, beyond)
