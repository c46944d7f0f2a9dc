"""The largest friction margin that the worst loaded contact can have.

In cones narrowed by an angle m, forces within their limits exert at most t(m) times the wrench, which falls with m. The
margin is the root t(m) = 1; each evaluation of t is a cone program. Where m passes the friction angle of a contact,
that contact has to be unloaded, and t may jump: then that angle is the margin. Contacts without friction have no margin
to lose, and stay.

t may jump elsewhere too: where narrower cones make the wrench infeasible for forces of any size, t falls as a root of
the distance, and then at once to zero, so that close by no program is solved to a proof. There the search goes on by a
second problem, whose value rises in proportion: the excess by which forces that exert the wrench have to leave their
narrower cones.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array, lax

from jaxgrasp.numerics import cone_program
from jaxgrasp.numerics.cone_program import ConeProgram
from jaxgrasp.numerics.iterate import varying_like
from jaxgrasp.numerics.tiling import beside, merged, over_chosen
from jaxgrasp.numerics.vec3 import safe_divide, safe_sqrt
from jaxgrasp.problem.cone_problem import (
    ConeProblem,
    Inequalities,
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

FIRST = 10
"""Evaluations for all problems; problems that need more are gathered."""
STEPS = 40
LEFT = 8
"""Number of problems that are solved together after that."""
ENOUGH = 10.0
"""Largest multiple of the wrench that is of interest."""
LITTLE = 1e-3
"""Multiple of the wrench below which the slope tells nothing about the root."""
OVER = 5
APART_EXPONENT = 0.45
"""Distance of the two evaluations on both sides of the root, as an exponent of the machine epsilon [rad]."""
FARTHER = 16
"""Factor of that distance for the next evaluation, where programs close to the root cannot be solved to a proof."""
WHOLE_WRENCH_EXPONENT = 0.5
"""Exponent of the machine epsilon: tolerance of the multiple 1, since limits may leave no freedom beyond it."""
SOUND_EXPONENT = 0.45
"""Largest residual of wrench and limits, as an exponent of the machine epsilon."""
CLOSE = 4.0
"""Multiple of the distance by ``APART_EXPONENT``: if the sides of the root are farther apart, the second problem
refines them."""
JUMP = 1e-4
"""Excess of the multiple over 1, on the root's near side, that indicates a jump."""
NORMAL_FORCE_CAP = 1e3
"""Largest normal force in units of the load where no limit is lower: the margin grows without end with the force."""


class _MarginEvaluation(NamedTuple):
    """Feasible multiple of the wrench in cones narrowed by an angle, or the excess at the wrench."""

    times: Array
    """Multiple of the wrench that the computed forces exert ``(B,)``; 1 in the second problem."""
    most: Array
    """Multiple of the wrench that no forces exceed."""
    excess: Array
    """Distance of each force from its cone in the second problem, as a normal force; 0 in the first."""
    slope: Array
    """Derivative of that multiple, or of minus the excess, by the angle."""
    y: Array
    multipliers: Multipliers
    residual: Array


def search(conic: ConeProblem) -> SearchResult:
    """Find forces of the largest margin; its bound is the margin of narrower cones that were proven insufficient."""
    conic = _bounded(conic)
    state = _bracket(conic)
    near = state.at_low
    y = _inside(near.y) / jnp.where(near.times > 0, near.times, 1)[:, None, None]
    # Contacts that may be loaded on the near side of a jump but not on its far side.
    angles = _angles(conic)
    unloaded = (angles >= state.low[:, None]) & (angles <= state.proven[:, None] + _apart(angles))
    jumps = jnp.any(unloaded, -1) & (near.times > 1 + JUMP)
    shares = jnp.where(jumps[:, None] & unloaded, 1 / jnp.maximum(jnp.sum(unloaded, -1, keepdims=True), 1), 0)
    # Forces of the near side and the proof of the far side form a primal-dual pair, however steep t is in between.
    slope = _slope(conic, _narrow(conic, state.low), state.beyond, y)
    is_falling = ~jumps & (slope < 0)
    # Implicit function theorem: dm = -dt / t'(m). In these units the Lagrangian moves as the margin does.
    unit = jnp.where(is_falling, 1 / jnp.where(is_falling, slope, -1), 0)
    multipliers = jax.tree.map(lambda x: x * beside(unit, x), state.beyond)
    y = jnp.concatenate([y[..., :1], y[..., 1:] * _shares(conic, state.low)[..., None]], -1)
    return SearchResult(y, state.proven, multipliers, shares, near.residual)


def value(conic: ConeProblem, y: Array) -> Array:
    """Compute the smallest margin of a loaded contact with friction ``(B,)``."""
    tangential = safe_sqrt(jnp.sum(y[..., 1:] ** 2, -1))
    angles = jnp.arctan(conic.friction)
    margins = angles - jnp.arctan2(conic.friction * tangential, jnp.where(tangential > 0, y[..., 0], 1))
    counts = conic.present & (conic.friction > 0) & ((y[..., 0] > 0) | (tangential > 0))
    return jnp.min(jnp.where(counts, margins, widest(conic)[:, None]), -1)


def widest(conic: ConeProblem) -> Array:
    """Return the largest friction angle ``(B,)``, which no margin exceeds."""
    return jnp.max(_angles(conic), -1)


def lagrangian(conic: ConeProblem, result: SearchResult) -> Array:
    """Evaluate the function whose derivative by the problem is that of the margin: of the root, or of the friction
    angle at a jump."""
    assert result.shares is not None
    margin = value(lax.stop_gradient(conic), result.y)
    conic = _bounded(conic)
    share = _shares(conic, margin)
    y = jnp.concatenate([result.y[..., :1], safe_divide(result.y[..., 1:], lax.stop_gradient(share)[..., None])], -1)
    constraint_terms = constraints(_narrow(conic, margin), result.multipliers, y)
    return jnp.sum(result.shares * jnp.arctan(conic.friction), -1) + constraint_terms


def _bounded(conic: ConeProblem) -> ConeProblem:
    assert conic.normal_max is not None
    return conic._replace(normal_max=jnp.where(conic.present, jnp.minimum(conic.normal_max, NORMAL_FORCE_CAP), jnp.inf))


def _apart(like: Array) -> float:
    return float(jnp.finfo(like.dtype).eps) ** APART_EXPONENT


def _angles(conic: ConeProblem) -> Array:
    """Return the friction angles of contacts ``(B, n)``; 0 for absent contacts."""
    return jnp.where(conic.present, jnp.arctan(conic.friction), 0)


def _narrow(conic: ConeProblem, margin: Array) -> ConeProblem:
    """Narrow the cones by an angle ``(B,)``; a contact whose own angle is smaller is removed."""
    share = _shares(conic, margin)
    is_present = conic.present & ((_angles(conic) >= margin[:, None]) | (conic.friction == 0))

    def scale(columns: Array) -> Array:
        parts = jnp.concatenate([columns[..., :1], columns[..., 1:] * share[:, None, :, None]], -1)
        return jnp.where(is_present[:, None, :, None], parts, 0)

    rows = None if conic.rows is None else scale(conic.rows)
    return conic._replace(columns=scale(conic.columns), friction=share * conic.friction, present=is_present, rows=rows)


def _shares(conic: ConeProblem, margin: Array) -> Array:
    """Compute the remaining friction as a share of the friction ``(B, n)``."""
    left = jnp.tan(jnp.maximum(jnp.arctan(conic.friction) - margin[:, None], 0))
    return safe_divide(left, conic.friction)


def _inside(y: Array) -> Array:
    """Project forces into their cones, where rounding may have left small ones outside."""
    normal_force = jnp.maximum(y[..., :1], 0)
    tangential = safe_sqrt(jnp.sum(y[..., 1:] ** 2, -1, keepdims=True))
    return jnp.concatenate(
        [normal_force, y[..., 1:] * jnp.where(tangential > normal_force, safe_divide(normal_force, tangential), 1)], -1
    )


def _evaluate(full: ConeProblem, margin: Array, relaxed: Array) -> _MarginEvaluation:
    """Solve for the largest multiple of the wrench, or where ``relaxed (B,)`` for the least excess at the wrench."""
    conic = _narrow(full, margin)
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
    sufficient = jnp.where(relaxed, 0, bounds.pop("enough")[:, 0])
    del bounds["positive"]
    multipliers = Multipliers(-best.equality, bounds)
    y = jnp.where(conic.present[..., None], best.point[:, :-1].reshape(size, n, c), 0)
    times, most = jnp.where(relaxed, 1, best.point[:, -1]), _multiple_bound(conic, multipliers, sufficient)
    excess = jnp.where(relaxed, best.point[:, -1], 0)
    if conic.normal_min is not None:
        # A removed contact cannot exert its least normal force.
        lacking = jnp.any(full.present & ~conic.present & (conic.normal_min > 0), -1)
        times, most = jnp.where(lacking, 0, times), jnp.where(lacking, 0, most)
    return _MarginEvaluation(times, most, excess, _slope(full, conic, multipliers, y), y, multipliers, best.residual)


def _slope(full: ConeProblem, conic: ConeProblem, multipliers: Multipliers, y: Array) -> Array:
    """Compute the derivative of the multiple by the angle ``(B,)``, from the work of friction."""
    # d tan(a) / da / tan(a): relative change of the remaining friction for a radian.
    shrinks = -safe_divide(1 + conic.friction**2, conic.friction)
    pays = y[..., 0] * contact_power(conic, multipliers).across
    return jnp.sum(jnp.where(conic.present & (full.friction > 0), pays * shrinks, 0), -1)


def _inequalities(conic: ConeProblem, relaxed: Array) -> Inequalities:
    """Collect the limits; least normal forces scale with the multiple, as the wrench does. Excesses are positive."""
    limits = limits_of(conic, 1)
    if conic.normal_min is not None:
        rows, ends = limits["normal_min"]
        fixed = relaxed[:, None]
        rows = rows.at[..., -1].set(jnp.where(fixed, 0, conic.normal_min))
        limits["normal_min"] = rows, jnp.where(fixed, ends, 0)
    last = jnp.zeros((conic.right.shape[0], 1, conic.width + 1), conic.right.dtype).at[..., -1].set(1)
    limits["enough"] = last, jnp.where(relaxed[:, None], jnp.inf, jnp.full_like(conic.right[:, :1], ENOUGH))
    limits["positive"] = -last, jnp.where(relaxed[:, None], 0, jnp.full_like(conic.right[:, :1], jnp.inf))
    return limits


def _multiple_bound(conic: ConeProblem, multipliers: Multipliers, sufficient: Array) -> Array:
    """Compute the bound of the multiple by the multipliers; those of largest normal forces are raised until no contact
    works along them ``(B,)``."""
    assert conic.normal_max is not None
    push = jnp.maximum(contact_power(conic, multipliers).per_normal_force, 0)
    raised = jnp.sum(jnp.where(push > 0, push * conic.normal_max, 0), -1)
    supplied = limit_work(conic, multipliers) + ENOUGH * sufficient + raised
    required = required_work(conic, multipliers) + sufficient
    return jnp.where(required > 0, supplied / jnp.where(required > 0, required, 1), jnp.inf)


class _State(NamedTuple):
    """State of the root search."""

    angles: Array
    """Friction angles ``(B, n)``, where the multiple may jump; beyond the widest no contact remains."""
    low: Array
    """Largest angle at which the wrench was feasible; 0 at the start."""
    high: Array
    """Smallest angle at which it was not."""
    proven: Array
    """Smallest angle at which it is proven infeasible."""
    relaxed: Array
    """True while the second problem is solved."""
    angle: Array
    """Next angle to evaluate."""
    root: Array
    """Angle at which the search ended."""
    phase: Array
    """0 during the search for the root; then 1 for an evaluation on its near side, and higher for those on its far
    side."""
    at_low: _MarginEvaluation
    """Evaluation at ``low``."""
    beyond: Multipliers
    """Multipliers of the proof at ``proven``, if any."""


def _bracket(conic: ConeProblem) -> _State:
    """Find two close angles, between which the wrench becomes infeasible, and the evaluation at the smaller."""
    widest_angle = widest(conic)
    zero = 0 * widest_angle
    no_evaluation = jax.tree.map(
        lambda x: jnp.zeros(x.shape, x.dtype), jax.eval_shape(_evaluate, conic, zero, zero > 0)
    )
    phase = zero.astype(jnp.int32)
    start = _State(
        _angles(conic),
        zero,
        widest_angle,
        widest_angle,
        zero > 0,
        zero,
        zero,
        phase,
        no_evaluation,
        no_evaluation.multipliers,
    )

    state = _advance(conic, start, FIRST)
    return over_chosen(partial(_advance, count=STEPS), conic, state, state.phase < OVER, LEFT)


def _advance(conic: ConeProblem, state: _State, count: int) -> _State:
    """Run at most ``count`` more steps of the search."""

    def step(carry):
        steps, state = carry
        advanced = _step(state, _evaluate(conic, state.angle, state.relaxed))
        return steps + 1, merged(state.phase == OVER, state, advanced)

    state = varying_like(state, conic)
    return lax.while_loop(lambda c: (c[0] < count) & ~jnp.all(c[1].phase == OVER), step, (jnp.int32(0), state))[1]


def _bisect(angles: Array, low: Array, high: Array) -> Array:
    """Choose an angle inside the bracket: a possible jump; just behind the last jump; else the middle."""
    middle, apart = (low + high) / 2, _apart(low)
    between = (angles > low[:, None]) & (angles < high[:, None])
    far = jnp.where(between, jnp.abs(angles - middle[:, None]), jnp.inf)
    nearest = jnp.take_along_axis(angles, jnp.argmin(far, -1)[:, None], -1)[:, 0]
    behind = jnp.any(angles == low[:, None], -1) & (low > 0) & (high > low + apart)
    return jnp.where(behind, low + apart / 2, jnp.where(jnp.any(between, -1), nearest, middle))


def _step(state: _State, evaluation: _MarginEvaluation) -> _State:
    """Make a Newton step for log t, which is nearly linear over most of the range; bisect outside the bracket.

    The excess is itself nearly linear beyond the root; before it, it is 0.
    """
    apart = _apart(state.angle)
    eps = float(jnp.finfo(state.angle.dtype).eps)
    is_whole = (evaluation.times >= 1 - eps**WHOLE_WRENCH_EXPONENT) & (evaluation.excess <= eps**WHOLE_WRENCH_EXPONENT)
    is_feasible = is_whole & (evaluation.residual <= eps**SOUND_EXPONENT)
    is_new_low = is_feasible & (state.angle >= state.low)
    low = jnp.where(is_new_low, state.angle, state.low)
    high = jnp.where(is_feasible, state.high, jnp.minimum(state.angle, state.high))
    proves = (evaluation.most < 1 - eps**WHOLE_WRENCH_EXPONENT) & (state.angle <= state.proven)
    proven = jnp.where(proves, state.angle, state.proven)
    is_falling = (evaluation.times > LITTLE) & (evaluation.slope < 0) & (~state.relaxed | ~is_whole)
    rate = jnp.where(is_falling, evaluation.slope, -1) / jnp.where(is_falling, evaluation.times, 1)
    # The second problem has times = 1, the first has excess = 0.
    newton = state.angle + (evaluation.excess - jnp.log(jnp.where(is_falling, evaluation.times, 1))) / rate
    inside = is_falling & (newton > low) & (newton < high)
    is_near = is_falling & (jnp.abs(newton - state.angle) <= apart / 4)
    next_angle = jnp.where(is_near, state.angle, jnp.where(inside, newton, _bisect(state.angles, low, high)))
    # Where full cones barely suffice, or the root is the widest angle, the bracket is empty.
    arrived = (state.phase == 0) & (is_near | (high - low <= apart))
    root = jnp.where(arrived, next_angle, state.root)
    phase = jnp.where((state.phase > 0) | arrived, state.phase + 1, 0)
    phase = jnp.where((phase > 2) & (proven <= root + apart), OVER, phase)
    distance = apart * FARTHER ** (phase - 2).astype(root.dtype)
    sides = jnp.where(
        phase == 1, jnp.maximum(root - apart, low), jnp.minimum(root + distance, jnp.max(state.angles, -1))
    )
    angle = jnp.where(phase == 0, next_angle, sides)
    at_low, beyond = merged(is_new_low, evaluation, state.at_low), merged(proves, evaluation.multipliers, state.beyond)
    # The second problem starts beyond the root, and its excess leads back to it.
    starts_relaxed = (phase == OVER) & ~state.relaxed & (proven - low > CLOSE * apart)
    phase, angle, high = (
        jnp.where(starts_relaxed, new, old) for new, old in ((0, phase), (proven, angle), (proven, high))
    )
    proven = jnp.maximum(proven, low)
    return _State(state.angles, low, high, proven, state.relaxed | starts_relaxed, angle, root, phase, at_low, beyond)
