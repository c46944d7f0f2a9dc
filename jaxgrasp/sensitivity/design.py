"""Design by gradient: parameters of a task, within bounds, that raise its worst margin."""

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
    entries_of,
    row_of,
    select_entries,
    values_at,
    with_values,
)
from jaxgrasp.sensitivity.trajectory import OutputOf, outputs_of, read_times
from jaxgrasp.validation.checked import checked

SOFTNESS = (0.3, 0.1, 0.03, 0.01, 0.003)
"""Softness of the smallest margin, in stages, relative to the scale of the margins."""
LOW, LEAST = 0.25, 0.1
"""The scale is the distance of this quantile of the margins above the smallest one, at the start, and at least this
part of the smallest one's size: margins far above the worst, however large, do not affect it."""
NUDGE = 0.02
"""A symmetric grasp lies on a ridge, where the gradient is zero: the search starts this far beside it."""
FARTHEST = 60.0
"""Unbounded variables beyond this represent a parameter at its bound."""

Bounds = tuple[AnyArray | float | int, AnyArray | float | int]


class Design(eqx.Module):
    """A task with a raised worst margin, beside the original one."""

    task: Task
    """The task with the raised parameters."""
    parameters: tuple[Entry, ...] = eqx.field(static=True)
    """Free parameters."""
    values: Float[Array, "P"]
    values_before: Float[Array, "P"]
    margins: Float[Array, "T M"]
    margins_before: Float[Array, "T M"]

    @property
    def worst(self) -> float:
        """Return the smallest margin over all times."""
        return float(jnp.min(self.margins))

    @property
    def worst_before(self) -> float:
        """Return the smallest margin over all times of the original task."""
        return float(jnp.min(self.margins_before))

    @property
    def moves(self) -> dict[str, tuple[float, float]]:
        """Return each parameter's value before and after, by its label."""
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
    """Raise the smallest margin of a whole task by its parameters, within bounds, to a local maximum.

    Optimistix's BFGS starts from the original task, on a soft minimum of all margins at all times that hardens in
    stages; gradients are exact. The best stage is returned, never a result worse than the start. The maximum is local:
    start from several tasks where that matters.

    Args:
        task: grasp and wrench over time; its parameters must lie between the bounds.
        times: ascending ``(T,)`` [s]. Margins between them are not considered.
        margin: (grasp, wrench) -> margins to raise, as an array or a tree of arrays for the leading axis of the
            times: ``Output("friction_margin", "B")`` for the closed form, [`jaxgrasp.sensitivity.friction_reserve`][]
            for the best that the grasp can do, or a function of your own. +inf is no limit.
        within: free parameters by name, as for [`jaxgrasp.sensitivity.sensitivity_matrix`][], and the least and the
            largest value of each: numbers, or an array with an element for each entry. The search scales its steps by
            them: make them no wider than necessary.
        totals: names of parameters, all of them in ``within``, the sum of whose entries is kept constant, such as
            ``"contributions"``: a hand that may not press harder.
        labels: as for [`jaxgrasp.sensitivity.sensitivity_matrix`][].
        steps: largest number of steps of each of the five stages.

    Returns:
        A Design.

    Raises:
        ValueError: for names that are unknown or given twice, a start that is not between its bounds or has a margin
            that is not a number, and as
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
    start = values_at(task.parameters, moving)
    bounded = _BoundedParameters(low, high, start, groups)
    before = _evaluate(task, margin, instants, moving, start)
    _check_start(before, instants, outputs)
    points = [start]
    free = jnp.log((start - low) / (high - start)) + NUDGE * jax.random.normal(
        jax.random.key(0), start.shape, start.dtype
    )
    scale = _scale(np.asarray(before))
    for softness in SOFTNESS:
        measures = jnp.asarray((scale, softness), start.dtype)
        free, point = _maximise(task, margin, instants, moving, bounded, free, measures, steps)
        points.append(point)
    candidates = [before, *(_evaluate(task, margin, instants, moving, point) for point in points[1:])]
    worst = [float(jnp.min(margins)) for margins in candidates]
    best = max(range(len(worst)), key=lambda k: -math.inf if math.isnan(worst[k]) else worst[k])
    raised = Task(with_values(task.parameters, moving, points[best]), task.at)
    return Design(raised, moving, points[best], start, candidates[best], before)


class _BoundedParameters(eqx.Module):
    """Map from unbounded variables to parameters inside their bounds, low + (high - low) sigmoid(x)."""

    low: Array
    high: Array
    start: Array
    groups: tuple[tuple[int, ...], ...] = eqx.field(static=True)
    """Positions of entries whose sums are kept constant."""

    def at(self, free: Array) -> Array:
        """Return the parameters inside their bounds, with the sums of the start."""
        for group in self.groups:
            index = np.array(group)
            group_parameters = _BoundedParameters(self.low[index], self.high[index], self.start[index], ())
            free = free.at[index].add(group_parameters._shift(free[index]))
        return self.low + (self.high - self.low) * jax.nn.sigmoid(free)

    def _shift(self, free: Array) -> Array:
        """Find the shift of all variables that restores the sum of the start, which rises with the shift."""
        import optimistix

        eps = float(jnp.finfo(free.dtype).eps)
        # With these shifts all entries are at their lower bounds, or at their upper bounds.
        ends = {"lower": -FARTHEST - jnp.max(free), "upper": FARTHEST - jnp.min(free)}
        bisection: Any = optimistix.Bisection(rtol=eps, atol=4 * eps)  # type: ignore[call-arg]
        root: Any = optimistix.root_find(
            lambda shift, free: jnp.sum(self.at(free + shift)) - jnp.sum(self.start),
            bisection,
            jnp.zeros((), free.dtype),
            args=free,
            options=ends,
            throw=False,
        )
        return root.value


@eqx.filter_jit
def _maximise(
    task: Task,
    margin: OutputOf,
    times: Array,
    moving: tuple[Entry, ...],
    bounded: _BoundedParameters,
    free: Array,
    measures: Array,
    steps: int,
) -> tuple[Array, Array]:
    """Maximise the soft minimum from ``free``; return the unbounded variables and the parameters."""
    import optimistix

    def negative_soft_minimum(free: Array, measures: Array) -> Array:
        scale, softness = measures[0], measures[1]
        margins = _margins(task, margin, times, moving, bounded.at(free)) / scale
        # Infinite margins have weight zero. The line search refuses NaN and -inf.
        exponents = jnp.where(jnp.isposinf(margins), -jnp.inf, -margins / softness)
        return softness * jax.nn.logsumexp(exponents)

    # Tight tolerances: the search leaves a ridge by small steps, which are no sign of convergence.
    bfgs: Any = optimistix.BFGS(rtol=1e-9, atol=1e-12)
    result: Any = optimistix.minimise(negative_soft_minimum, bfgs, free, args=measures, max_steps=steps, throw=False)
    return result.value, bounded.at(result.value)


@eqx.filter_jit
def _evaluate(task: Task, margin: OutputOf, times: Array, moving: tuple[Entry, ...], values: Array) -> Array:
    """Compute the margins ``(T, M)``, compiled."""
    return _margins(task, margin, times, moving, values)


def _scale(margins: np.ndarray) -> float:
    """Return the scale of the margins that may become the worst, in their own unit."""
    finite = margins[np.isfinite(margins)]
    if not finite.size:
        return 1.0
    least = finite.min()
    scale = max(np.quantile(finite, LOW) - least, LEAST * abs(least))
    return float(scale if scale > 0 else finite.max() - least or 1.0)


def _margins(task: Task, margin: OutputOf, times: Array, moving: tuple[Entry, ...], values: Array) -> Array:
    """Compute the margins ``(T, M)``; the solvers get all times as one batch."""
    moved = Task(with_values(task.parameters, moving, values), task.at)
    return row_of(margin(*jax.vmap(moved)(times)), 1)


def _read_bounds(
    task: Task, entries: Sequence[Entry], within: Mapping[str, Bounds]
) -> tuple[tuple[Entry, ...], Array, Array]:
    """Read the free parameters and their bounds; raise ValueError where one does not start between them."""
    rows: dict[Entry, tuple[float, float]] = {}
    for name, bounds in within.items():
        selected = select_entries(entries, [name])
        for entry in selected:
            if entry in rows:
                raise ValueError(f"within has {entry.label} twice, once by {name!r}: expected each parameter once")
        if not hasattr(bounds, "__len__") or len(bounds) != 2:
            raise ValueError(f"within has {bounds!r} for {name}: expected (the least, the largest)")
        low, high = (_broadcast(name, bound, len(selected)) for bound in bounds)
        rows |= dict(zip(selected, zip(low, high, strict=True), strict=True))
    moving = select_entries(entries, list(within))
    low, high = np.array([rows[entry] for entry in moving]).T
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
    """Return the positions of each total's entries among the free parameters, which no two totals share."""
    if isinstance(totals, str):
        raise ValueError(f"totals is {totals!r}: expected a list of names")
    groups: list[tuple[int, ...]] = []
    for name in totals:
        for entry in select_entries(entries, [name]):
            if entry not in moving:
                raise ValueError(f"totals has {entry.label}, which is not in within: expected a free parameter")
            if any(moving.index(entry) in group for group in groups):
                raise ValueError(f"totals has {entry.label} twice, once by {name!r}: expected each parameter once")
        groups.append(tuple(moving.index(entry) for entry in select_entries(entries, [name])))
    return tuple(groups)


def _check_start(margins: Array, times: Array, outputs: Sequence[Entry]) -> None:
    """Raise ValueError where the original task has margins without a gradient."""
    lost = np.isnan(margins) | np.isneginf(margins)
    for k, m in np.argwhere(lost):
        raise ValueError(f"{outputs[m].label} is {margins[k, m]} at times[{k}], {times[k]:g} s: expected a number")
