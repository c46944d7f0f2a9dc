"""Design by gradient: the parameters of a task, within bounds, that raise its worst margin."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxgrasp.model.arrays import AnyArray, Float
from jaxgrasp.model.task import Task
from jaxgrasp.sensitivity.naming import (
    Entry,
    Labels,
    as_arrays,
    check_labels,
    chosen,
    entries_of,
    row_of,
    values_at,
    with_values,
)
from jaxgrasp.sensitivity.trajectory import OutputOf, outputs_of, read_times
from jaxgrasp.validation.checked import checked

SOFTNESS = (0.3, 0.1, 0.03, 0.01, 0.003)
"""Softness of the smallest margin, in stages, relative to the scale of the margins."""
LOW, LEAST = 0.25, 0.1
"""The scale is how far this quantile of the margins lies above the smallest one, where all begin, and at least this
part of the smallest one's size: what is far from being the worst, however large, says nothing about it."""
NUDGE = 0.02
"""A grasp that is symmetric stands on a ridge, from which no gradient leads: the climb begins so far beside it."""
FARTHEST = 60.0
"""Unbounded variables beyond this stand for a parameter at its bound."""

Bounds = tuple[AnyArray | float | int, AnyArray | float | int]


class Design(eqx.Module):
    """A task whose worst margin was raised, beside the one it was made from."""

    task: Task
    """The task with the raised parameters."""
    parameters: tuple[Entry, ...] = eqx.field(static=True)
    """What was free to move."""
    values: Float[Array, "P"]
    values_before: Float[Array, "P"]
    margins: Float[Array, "T M"]
    margins_before: Float[Array, "T M"]

    @property
    def worst(self) -> float:
        """The smallest margin of all times."""
        return float(jnp.min(self.margins))

    @property
    def worst_before(self) -> float:
        """The smallest margin of all times, of the task as it was given."""
        return float(jnp.min(self.margins_before))

    @property
    def moves(self) -> dict[str, tuple[float, float]]:
        """Each parameter's value before and after, by its label."""
        pairs = zip(self.parameters, self.values_before.tolist(), self.values.tolist(), strict=True)
        return {entry.label: (before, after) for entry, before, after in pairs}


@checked
def raise_worst(
    task: Task,
    times: Float[AnyArray, "T"] | Sequence[float],
    margin: OutputOf,
    within: Mapping[str, Bounds],
    *,
    totals: Sequence[str] = (),
    labels: Labels | None = None,
    steps: int = 60,
) -> Design:
    """The parameters, within bounds, for which the smallest margin of a whole task is largest, nearby.

    A climb by optimistix's BFGS from the task as it is, on a soft minimum of all margins at all times that hardens in
    stages; gradients are exact. The best of the stages is returned, and never what is worse than the start. It finds
    a summit, not always the highest: start it from several tasks where that matters.

    Args:
        task: grasp and wrench over time; where it begins must lie between the bounds.
        times: ascending ``(T,)`` [s]. What lies between them is not looked at.
        margin: (grasp, wrench) -> what is to be large, as an array or a tree of arrays for the leading axis of the
            times: ``Output("friction_margin", "B")`` for the closed form, [`jaxgrasp.sensitivity.friction_reserve`][]
            for whatever the grasp could do, or one of your own. +inf counts as no limit.
        within: what may move, by the names of parameters as for [`jaxgrasp.sensitivity.sensitivity_matrix`][], and the
            least and the largest value of each: numbers, or one for each entry. They are the climb's measure of
            how far is far: let them be no wider than what is meant.
        totals: names of parameters, all of them in ``within``, the sum of whose entries stays as it is, such as
            ``"contributions"``: a hand that may not press harder.
        labels: as for [`jaxgrasp.sensitivity.sensitivity_matrix`][].
        steps: the most steps of each of the five stages.

    Returns:
        A Design.

    Raises:
        ValueError: for names that are unknown or meant twice, a start that is not between its bounds or has a margin
            that is no number, and as
            [`jaxgrasp.sensitivity.sensitivity_trajectory`][] does.
    """
    instants = read_times(times)
    task = as_arrays(task)
    entries = entries_of(task.parameters, labels)
    outputs = outputs_of(task, margin, instants, labels)
    check_labels(labels, (*entries, *outputs))
    moving, low, high = _read_bounds(task, entries, within)
    groups = _read_totals(totals, entries, moving)
    if not (isinstance(steps, int) and steps >= 1):
        raise ValueError(f"steps is {steps!r}: expected a whole number, 1 or more")
    here = values_at(task.parameters, moving)
    room = _Room(low, high, here, groups)
    before = _look(task, margin, instants, moving, here)
    _check_start(before, instants, outputs)
    points = [here]
    free = jnp.log((here - low) / (high - here)) + NUDGE * jax.random.normal(jax.random.key(0), here.shape, here.dtype)
    scale = _scale(np.asarray(before))
    for softness in SOFTNESS:
        measures = jnp.asarray((scale, softness), here.dtype)
        free, reached = _climb(task, margin, instants, moving, room, free, measures, steps)
        points.append(reached)
    tried = [before, *(_look(task, margin, instants, moving, point) for point in points[1:])]
    worst = [float(jnp.min(margins)) for margins in tried]
    best = max(range(len(worst)), key=lambda k: -math.inf if math.isnan(worst[k]) else worst[k])
    raised = Task(with_values(task.parameters, moving, points[best]), task.at)
    return Design(raised, moving, points[best], here, tried[best], before)


class _Room(eqx.Module):
    """Where parameters may be, as a function of variables that know no bounds."""

    low: Array
    high: Array
    start: Array
    groups: tuple[tuple[int, ...], ...] = eqx.field(static=True)
    """Places of entries whose sums stay those of the start."""

    def at(self, free: Array) -> Array:
        """The parameters: inside their bounds, with the sums that they must have."""
        for group in self.groups:
            places = np.array(group)
            only = _Room(self.low[places], self.high[places], self.start[places], ())
            free = free.at[places].add(only._shift(free[places]))
        return self.low + (self.high - self.low) * jax.nn.sigmoid(free)

    def _shift(self, free: Array) -> Array:
        """What to add to all so that the sum is that of the start: it rises with the shift."""
        import optimistix

        eps = float(jnp.finfo(free.dtype).eps)
        # So far all entries are at their one bounds, and so far at the other.
        ends = {"lower": -FARTHEST - jnp.max(free), "upper": FARTHEST - jnp.min(free)}
        bisection: Any = optimistix.Bisection(rtol=eps, atol=4 * eps)  # type: ignore[call-arg]
        found: Any = optimistix.root_find(
            lambda shift, free: jnp.sum(self.at(free + shift)) - jnp.sum(self.start),
            bisection,
            jnp.zeros((), free.dtype),
            args=free,
            options=ends,
            throw=False,
        )
        return found.value


@eqx.filter_jit
def _climb(
    task: Task,
    margin: OutputOf,
    times: Array,
    moving: tuple[Entry, ...],
    room: _Room,
    free: Array,
    measures: Array,
    steps: int,
) -> tuple[Array, Array]:
    """From ``free`` to where the soft minimum is largest; there, the free variables and the parameters."""
    import optimistix

    def sunk(free: Array, measures: Array) -> Array:
        scale, softness = measures[0], measures[1]
        margins = _margins(task, margin, times, moving, room.at(free)) / scale
        # What has no limit weighs nothing. What is no number, or infinitely bad, is refused by the line search.
        felt = jnp.where(jnp.isposinf(margins), -jnp.inf, -margins / softness)
        return softness * jax.nn.logsumexp(felt)

    # Ridges are left slowly at first: no small step means that it has arrived.
    bfgs: Any = optimistix.BFGS(rtol=1e-9, atol=1e-12)
    found: Any = optimistix.minimise(sunk, bfgs, free, args=measures, max_steps=steps, throw=False)
    return found.value, room.at(found.value)


@eqx.filter_jit
def _look(task: Task, margin: OutputOf, times: Array, moving: tuple[Entry, ...], values: Array) -> Array:
    return _margins(task, margin, times, moving, values)


def _scale(margins: np.ndarray) -> float:
    """By how much margins differ that may become the worst, in their own unit."""
    finite = margins[np.isfinite(margins)]
    if not finite.size:
        return 1.0
    least = finite.min()
    scale = max(np.quantile(finite, LOW) - least, LEAST * abs(least))
    return float(scale if scale > 0 else finite.max() - least or 1.0)


def _margins(task: Task, margin: OutputOf, times: Array, moving: tuple[Entry, ...], values: Array) -> Array:
    """``(T, M)``; the solvers get all times as one batch."""
    moved = Task(with_values(task.parameters, moving, values), task.at)
    return row_of(margin(*jax.vmap(moved)(times)), 1)


def _read_bounds(
    task: Task, entries: Sequence[Entry], within: Mapping[str, Bounds]
) -> tuple[tuple[Entry, ...], Array, Array]:
    """What may move, each entry's bounds, and an error where it does not begin between them."""
    rows: dict[Entry, tuple[float, float]] = {}
    for name, bounds in within.items():
        these = chosen(entries, [name])
        for one in these:
            if one in rows:
                raise ValueError(f"within has {one.label} twice, once by {name!r}: expected each parameter once")
        if not hasattr(bounds, "__len__") or len(bounds) != 2:
            raise ValueError(f"within has {bounds!r} for {name}: expected (the least, the largest)")
        low, high = (_broadcast(name, bound, len(these)) for bound in bounds)
        rows |= dict(zip(these, zip(low, high, strict=True), strict=True))
    moving = chosen(entries, list(within))
    low, high = np.array([rows[one] for one in moving]).T
    for entry, least, value, most in zip(moving, low, np.asarray(values_at(task.parameters, moving)), high):
        if not (least < value < most and math.isfinite(most - least)):
            raise ValueError(f"{entry.label} is {value:g}: expected between its finite bounds {least:g} and {most:g}")
    return moving, jnp.asarray(low), jnp.asarray(high)


def _broadcast(name: str, bound: AnyArray | float | int, count: int) -> np.ndarray:
    array = np.asarray(bound, float).ravel()
    if array.size not in (1, count):
        raise ValueError(f"a bound of {name} has {array.size} entries: expected one, or {count}")
    return np.broadcast_to(array, count)


def _read_totals(
    totals: Sequence[str], entries: Sequence[Entry], moving: Sequence[Entry]
) -> tuple[tuple[int, ...], ...]:
    """The places of each total's entries among those that move, no entry in two of them."""
    if isinstance(totals, str):
        raise ValueError(f"totals is {totals!r}: expected a list of names")
    groups: list[tuple[int, ...]] = []
    for name in totals:
        for one in chosen(entries, [name]):
            if one not in moving:
                raise ValueError(f"totals has {one.label}, which may not move: expected one that within names")
            if any(moving.index(one) in group for group in groups):
                raise ValueError(f"totals has {one.label} twice, once by {name!r}: expected each parameter once")
        groups.append(tuple(moving.index(one) for one in chosen(entries, [name])))
    return tuple(groups)


def _check_start(margins: Array, times: Array, outputs: Sequence[Entry]) -> None:
    """Raise ValueError where the task that is given has margins from which nothing can be climbed."""
    lost = np.isnan(margins) | np.isneginf(margins)
    for k, m in np.argwhere(lost):
        raise ValueError(f"{outputs[m].label} is {margins[k, m]} at times[{k}], {times[k]:g} s: expected a number")
