"""The least parameter with which a cone program has a point, many small programs at a time.

    minimise  theta   subject to   A x = b,   D x <= d,
                                   (theta x_i0, x_i1, x_i2, ...) in the second-order cone of each i,

where theta may multiply further entries too: what is allowed only grows with it, so that the program is quasiconvex, as
fractional programs are. Newton's method on the least of theta looks at a cone program for each theta. Here both go
together: a primal-dual interior-point method (Nesterov and Todd's scaling, Mehrotra's corrector, as ``cone_program.py``
has them) steps towards the central point of a program that is linear in theta too, and is made linear anew with each
step that succeeds: Dinkelbach's method as Crouzeix and Ferland scale it, one step at a time.

The equations of a step are as many as A and D have rows, whatever the number of cones. Arrays are batch-last:
``(n, B)`` for what belongs to the cones of a program, ``(1, B)`` for what belongs to the program.
"""

from collections.abc import Callable
from functools import reduce
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array, lax

from jaxgrasp.numerics import ldl, vec3
from jaxgrasp.numerics.fused_cpu_kernel import computed_once, fused_cpu_kernel
from jaxgrasp.numerics.iterate import varying_like

STEPS = 32
NEAR = 0.98
"""Part of the way to the cones' surface that a step may go."""
GOOD = 0.5
"""Steps that go so far of their way succeed: only then cones are made linear anew, so that short ones help too."""
FALL, RISE = 0.9, 2.0
"""By how much of itself the parameter may fall and rise in one step."""
SHORTEST = 1e-8
"""A step so short is none."""
RIDGE = 8.0
"""Roundings of its diagonal that are added to a matrix, which has no inverse where cones cannot reach all of b."""
LEAST_GAP_EXPONENT = 0.66
"""An exponent of the machine epsilon: the gap below which nothing is gained, but digits of the equations are lost."""
REFINED = 1
"""Times that the equations of a step are solved again for what they leave."""

Vector = list[Array]
"""A vector of each cone: the entry that leads it, then the others, each ``(n, B)``."""
Rows = list[Array]
"""An entry of x in each row of A, and then of -D: ``(n, B)`` each."""


class QuasiconvexProgram(NamedTuple):
    """Programs, of which an interior point is known."""

    grown: list[Rows]
    """Columns of the entries that the parameter multiplies, the leading one first."""
    plain: list[Rows]
    """Columns of the others."""
    right: Array
    """b over -d ``(e + r, B)``."""
    present: Array
    """1 for cones that count, 0 for others, whose columns are zero ``(n, B)``."""


class InteriorPoint(NamedTuple):
    """State of each program, strictly inside its cones; vectors begin with the part that the parameter multiplies."""

    parameter: Array
    entries: Vector
    """x."""
    slack: Vector
    """What is in the cones; it becomes what the parameter and x make."""
    duals: Vector
    """What the multipliers below ask of the slack, in the end."""
    twist: Array
    """Multipliers of the equations ``(e, B)``."""
    spare: Array
    """What inequalities leave ``(r, B)``."""
    prices: Array
    """Multipliers of the inequalities."""
    base: Array
    """The parameter about which the cones are linear, until a step succeeds."""
    reference: Vector
    """Entries there, those that the parameter multiplies."""
    gap: Array
    """Between the parameter and what the multipliers prove."""
    owed: Array
    """By how much the parameter would have to grow, to first order, for equations to be met."""
    residual: Array
    """The largest that is missed of equations, and of what multipliers ask of each other."""
    steps: Array
    done: Array


Finished = Callable[[QuasiconvexProgram, InteriorPoint], Array]
"""Whether programs need no further step ``(1, B)``; a function that closes over nothing."""


def minimise(program: QuasiconvexProgram, start: InteriorPoint, finished: Finished) -> InteriorPoint:
    """Find the least parameters, as far as rounding lets them be found; programs that are ``done`` stay as they are."""

    def unfinished(state: InteriorPoint) -> Array:
        return ~jnp.all(state.done | (state.steps >= STEPS))

    start = varying_like(start, program)
    return lax.while_loop(unfinished, lambda state: _advance(program, state, finished), start)


class _Scaling(NamedTuple):
    """Nesterov and Todd's W = size (2 v v^T - J), v halfway between ``unit`` and the cone's axis: W z = W^-1 s."""

    unit: Vector
    size: Array


class _Aim(NamedTuple):
    """Target changes of the products of slack and multipliers."""

    cones: Vector
    """Slack, scaled by the inverse of W, and duals, scaled by W, are to add up to this."""
    spare: Array


class _Move(NamedTuple):
    """A step."""

    parameter: Array
    twist: list[Array]
    slack: Vector
    """Scaled by the inverse of W."""
    duals: Vector
    """Scaled by W."""
    spare: Array
    prices: Array


@fused_cpu_kernel
def _advance(program: QuasiconvexProgram, state: InteriorPoint, finished: Finished) -> InteriorPoint:
    """Take a predictor and a corrector step, which share their equations (Mehrotra 1992)."""
    system = computed_once(_system(program, state))
    middle = system.middle
    total, count = _complementarity(program, state)
    product = state.spare * state.prices
    foreseen = computed_once(_solve(program, system, state, _Aim([-m for m in middle], -product)))
    length = _room(program, state, [(middle, foreseen.slack), (middle, foreseen.duals)], foreseen)
    least = float(jnp.finfo(total.dtype).eps) ** LEAST_GAP_EXPONENT * state.parameter
    centring = jnp.maximum((1 - length) ** 3 * total, jnp.minimum(least, total)) / count
    bent = _product(foreseen.slack, foreseen.duals)
    aim = [-(s + p) for s, p in zip(_product(middle, middle), bent, strict=True)]
    aim[0] = aim[0] + centring
    aim = computed_once(_divide(middle, aim))
    spare = centring - product - foreseen.spare * foreseen.prices
    step = computed_once(_solve(program, system, state, _Aim(aim, spare)))
    return _moved(program, system, state, step, finished)


class _Equations(NamedTuple):
    """Return the change of the cones' and inequalities' slack by multipliers of the rows."""

    wide: list[Rows]
    softness: Array
    factors: Any

    def solve(self, right: list[Array]) -> list[Array]:
        """Solve for the multipliers, with one step of iterative refinement."""
        multipliers = ldl.solve(self.factors, right)
        for _ in range(REFINED):
            left = computed_once([r - b for r, b in zip(right, self._times(multipliers), strict=True)])
            multipliers = [x + y for x, y in zip(multipliers, ldl.solve(self.factors, left), strict=True)]
        return multipliers

    def _times(self, x: list[Array]) -> list[Array]:
        pushed = _pushed(self.wide, [_along(column, x) for column in self.wide])
        first = len(x) - len(self.softness)
        soft = [jnp.zeros_like(x[0])] * first + [self.softness[i : i + 1] for i in range(len(self.softness))]
        return [p + s * t for p, s, t in zip(pushed, soft, x, strict=True)]


class _System(NamedTuple):
    """The equations of a step."""

    scaling: _Scaling
    middle: Vector
    """W z."""
    wide: list[Rows]
    """Columns times W."""
    equations: _Equations
    by_parameter: list[Array]
    """The equations' derivative by the parameter."""
    answer: list[Array]
    """What solves the equations for that."""
    by_objective: Vector
    """Duals as the other multipliers have them."""
    off: Vector
    """Return the first-order product of parameter and x, less the slack."""
    residuals: list[Array]
    """What equations leave, once that is made up for; and what it is for inequalities."""


def _system(program: QuasiconvexProgram, state: InteriorPoint) -> _System:
    scaling = computed_once(_scaling(state.slack, state.duals))
    columns = computed_once([[r / state.base for r in rows] for rows in program.grown]) + program.plain
    rows = computed_once([_apply(scaling, list(row)) for row in zip(*columns, strict=True)])
    wide = [list(column) for column in zip(*rows, strict=True)]
    softness = state.spare / state.prices
    equations = _Equations(wide, softness, ldl.factor(_matrix(wide, softness)))
    by_parameter = [-total for total in _pushed(columns[: len(program.grown)], state.reference)]
    off = _product_error(program, state)
    bent = _pushed(columns, off)
    first = len(state.twist)
    residuals = [r + b for r, b in zip(_residuals(program, state)[:first], bent, strict=False)] + bent[first:]
    answer, by_objective = equations.solve(by_parameter), _objective_slope(program, state)
    middle = _apply(scaling, state.duals)
    return _System(scaling, middle, wide, equations, by_parameter, answer, by_objective, off, residuals)


def _solve(program: QuasiconvexProgram, system: _System, state: InteriorPoint, aim: _Aim) -> _Move:
    """Solve for the step of these target changes."""
    unlike = _apply(system.scaling, [a - d for a, d in zip(system.by_objective, state.duals, strict=True)])
    targets = computed_once([a - u for a, u in zip(aim.cones, unlike, strict=True)])
    used = sum(x * a for x, a in zip(state.reference, system.by_objective, strict=False))
    needed = 1 - vec3.totals(program.present * used)[0]
    first = len(state.twist)
    behind = aim.spare / state.prices - _slack_residual(program, state)
    right = [r - p for r, p in zip(system.residuals, _pushed(system.wide, targets), strict=True)]
    right = right[:first] + [r + behind[i : i + 1] for i, r in enumerate(right[first:])]
    plain = system.equations.solve(computed_once(right))
    pivot = _inner(system.by_parameter, system.answer)
    parameter = computed_once((_inner(system.by_parameter, plain) - needed) / pivot)
    twist = computed_once([p - parameter * a for p, a in zip(plain, system.answer, strict=True)])
    slack = computed_once([w + _along(column, twist) for w, column in zip(targets, system.wide, strict=True)])
    duals = [a - s for a, s in zip(aim.cones, slack, strict=True)]
    prices = jnp.concatenate(twist[first:])
    return _Move(parameter, twist, slack, duals, (aim.spare - state.spare * prices) / state.prices, prices)


def _moved(
    program: QuasiconvexProgram, system: _System, state: InteriorPoint, step: _Move, finished: Finished
) -> InteriorPoint:
    """After as much of a step as the cones allow."""
    present = program.present > 0
    slack = [jnp.where(present, d, 0) for d in _apply(system.scaling, step.slack)]
    duals = [jnp.where(present, d, 0) for d in _unapply(system.scaling, step.duals)]
    grown = [
        jnp.where(present, (d - o - r * step.parameter) / state.base, 0)
        for d, o, r in zip(slack, system.off, state.reference, strict=False)
    ]
    entries = grown + slack[len(grown) :]
    room = _room(program, state, [(state.slack, slack), (state.duals, duals)], step)
    change = step.parameter / state.base
    fast = jnp.maximum(change / RISE, -change / FALL)
    length = jnp.minimum(jnp.where(room < 1, NEAR * room, 1), 1 / jnp.maximum(fast, 1))

    def after(old: Any, move: Any) -> Any:
        return jax.tree.map(lambda x, d: x + length * d, old, move)

    is_long_step = length >= GOOD
    parameter, moved = after(state.parameter, step.parameter), after(state.entries, entries)
    candidate = state._replace(
        parameter=parameter,
        entries=moved,
        slack=after(state.slack, slack),
        duals=after(state.duals, duals),
        twist=after(state.twist, jnp.concatenate(step.twist[: len(state.twist)])),
        spare=after(state.spare, step.spare),
        prices=after(state.prices, step.prices),
        base=jnp.where(is_long_step, parameter, state.base),
        reference=[jnp.where(is_long_step, x, r) for x, r in zip(moved, state.reference, strict=False)],
    )
    candidate = _with_residual(program, candidate)
    sound = _inside(program, candidate) & jnp.isfinite(candidate.residual + candidate.gap) & ~state.done
    candidate = jax.tree.map(lambda new, old: jnp.where(sound, new, old), candidate, state)
    done = state.done | ~sound | (length < SHORTEST) | finished(program, candidate)
    return candidate._replace(done=done, steps=state.steps + jnp.where(state.done, 0, 1))


def _with_residual(program: QuasiconvexProgram, state: InteriorPoint) -> InteriorPoint:
    """With its gap, and what missing the equations is worth."""
    residuals, left = _residuals(program, state)[: len(state.twist)], _slack_residual(program, state)
    owed = _inner(residuals, [state.twist[i : i + 1] for i in range(len(residuals))])
    unlike = [a - d for a, d in zip(_objective_slope(program, state), state.duals, strict=True)]
    pairs = [*zip(state.slack, unlike, strict=True), *zip(_product_error(program, state), state.duals, strict=True)]
    (worth,) = vec3.totals(program.present * sum(p * q for p, q in pairs))
    residual = reduce(jnp.maximum, map(jnp.abs, residuals)) + jnp.abs(worth) + jnp.max(jnp.abs(left), 0, keepdims=True)
    return state._replace(
        gap=_complementarity(program, state)[0],
        owed=owed - jnp.sum(left * state.prices, 0, keepdims=True),
        residual=residual,
    )


def _complementarity(program: QuasiconvexProgram, state: InteriorPoint) -> tuple[Array, Array]:
    """Sum of the products of slack and multipliers, and of how many."""
    by_cones = sum(p * q for p, q in zip(state.slack, state.duals, strict=True))
    total, count = vec3.totals(program.present * by_cones, program.present)
    return total + jnp.sum(state.spare * state.prices, 0, keepdims=True), count + len(state.spare)


def _inside(program: QuasiconvexProgram, state: InteriorPoint) -> Array:
    inside = program.present == 0
    cones = (vector[0] > _length(vector[1:]) for vector in (state.slack, state.duals))
    inside = vec3.all_contacts(inside | reduce(jnp.logical_and, cones))
    return inside & jnp.all((state.spare > 0) & (state.prices > 0), 0, keepdims=True) & (state.parameter > 0)


def _room(program: QuasiconvexProgram, state: InteriorPoint, pairs: list[tuple[Vector, Vector]], move: _Move) -> Array:
    """Return the largest part of a move, at most 1, that stays inside the cones ``(1, B)``."""
    crossing = reduce(jnp.maximum, (_crossing(inside, moved) for inside, moved in pairs))
    least = jnp.max(jnp.where(program.present > 0, crossing, 0), 0, keepdims=True)
    single = jnp.maximum(-move.spare / state.spare, -move.prices / state.prices)
    return 1 / jnp.maximum(jnp.maximum(least, jnp.max(single, 0, keepdims=True)), 1)


def _crossing(inside: Vector, moved: Vector) -> Array:
    """Inverse of the number of times ``moved`` leads from a point inside the cone to its surface; below 0 if never."""
    root = _root(inside)
    unit = [x / root for x in inside]
    along = unit[0] * moved[0] - sum(u * m for u, m in zip(unit[1:], moved[1:], strict=True))
    across = [m - (along + moved[0]) / (unit[0] + 1) * u for u, m in zip(unit[1:], moved[1:], strict=True)]
    return (_length(across) - along) / root


def _product_error(program: QuasiconvexProgram, state: InteriorPoint) -> Vector:
    """Return the first-order product of parameter and x, less the slack."""
    further = state.parameter - state.base
    products = [state.base * x + further * r for x, r in zip(state.entries, state.reference, strict=False)]
    products += state.entries[len(products) :]
    return [jnp.where(program.present > 0, m - q, 0) for m, q in zip(products, state.slack, strict=True)]


def _objective_slope(program: QuasiconvexProgram, state: InteriorPoint) -> Vector:
    """Duals as multipliers have them; those of cones that do not count stand where they are."""
    rows = [multipliers[i : i + 1] for multipliers in (state.twist, state.prices) for i in range(len(multipliers))]
    by_objective = [-_along(column, rows) / state.base for column in program.grown]
    by_objective += [-_along(column, rows) for column in program.plain]
    return [jnp.where(program.present > 0, a, d) for a, d in zip(by_objective, state.duals, strict=True)]


def _residuals(program: QuasiconvexProgram, state: InteriorPoint) -> list[Array]:
    """Return the residuals of b and of -d."""
    pushed = _pushed(program.grown + program.plain, state.entries)
    return [program.right[i : i + 1] - p for i, p in enumerate(pushed)]


def _slack_residual(program: QuasiconvexProgram, state: InteriorPoint) -> Array:
    """Return the residual of the inequalities' slack."""
    return -jnp.concatenate(_residuals(program, state)[len(state.twist) :]) - state.spare


def _along(column: Rows, multipliers: list[Array]) -> Array:
    return sum((r * t for r, t in zip(column, multipliers, strict=True)), jnp.zeros_like(column[0]))


def _pushed(columns: list[Rows], vector: Vector) -> list[Array]:
    """Sum over cones the columns times a vector, in each row."""
    terms = zip(*([r * x for r in column] for column, x in zip(columns, vector, strict=True)), strict=True)
    return vec3.totals(*(reduce(jnp.add, row) for row in terms))


def _matrix(wide: list[Rows], softness: Array) -> list[list[Array]]:
    """Return the change of the cones' and inequalities' slack by multipliers of the rows."""
    rows = [
        vec3.totals(*(reduce(jnp.add, (column[i] * column[j] for column in wide)) for j in range(i + 1)))
        for i in range(len(wide[0]))
    ]
    ridge = RIDGE * float(jnp.finfo(softness.dtype).eps)
    first = len(rows) - len(softness)
    largest = reduce(jnp.maximum, (rows[i][i] for i in range(first)))
    for i in range(len(rows)):
        soft = softness[i - first : i - first + 1] if i >= first else ridge * largest
        rows[i][i] = (1 + ridge) * rows[i][i] + soft
    return rows


def _scaling(slack: Vector, duals: Vector) -> _Scaling:
    roots = _root(slack), _root(duals)
    plain, scaled_duals = ([x / root for x in vector] for vector, root in zip((slack, duals), roots, strict=True))
    cosine = jnp.sqrt((1 + sum(p * q for p, q in zip(plain, scaled_duals, strict=True))) / 2)
    unit = [(p + q) / (2 * cosine) for p, q in zip(plain, _mirrored(scaled_duals), strict=True)]
    return _Scaling(unit, jnp.sqrt(roots[0] / roots[1]))


def _apply(scaling: _Scaling, x: Vector) -> Vector:
    """W x."""
    first, *others = scaling.unit
    along = sum(u * y for u, y in zip(others, x[1:], strict=True))
    tail = [scaling.size * (y + u * (x[0] + along / (1 + first))) for u, y in zip(others, x[1:], strict=True)]
    return [scaling.size * (first * x[0] + along), *tail]


def _unapply(scaling: _Scaling, x: Vector) -> Vector:
    """Return W^-1 x."""
    return _apply(_Scaling(_mirrored(scaling.unit), 1 / scaling.size), x)


def _inner(a: list[Array], b: list[Array]) -> Array:
    return sum((p * q for p, q in zip(a, b, strict=True)), jnp.zeros_like(a[0]))


def _root(x: Vector) -> Array:
    """Root of the determinant."""
    size = _length(x[1:])
    return jnp.sqrt((x[0] - size) * (x[0] + size))


def _length(parts: Vector) -> Array:
    return jnp.sqrt(sum(p * p for p in parts))


def _mirrored(x: Vector) -> Vector:
    return [x[0], *(-p for p in x[1:])]


def _product(x: Vector, y: Vector) -> Vector:
    """Jordan's."""
    tail = (x[0] * q + y[0] * p for p, q in zip(x[1:], y[1:], strict=True))
    return [_inner(x, y), *tail]


def _divide(x: Vector, y: Vector) -> Vector:
    """u with x o u = y."""
    first = (x[0] * y[0] - sum(p * q for p, q in zip(x[1:], y[1:], strict=True))) / _root(x) ** 2
    return [first, *((q - first * p) / x[0] for p, q in zip(x[1:], y[1:], strict=True))]
