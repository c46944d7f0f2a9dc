"""Sensitivity trajectories: outputs over time along a task, how parameters move them, and what if (section II-G.3)."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cache, lru_cache, partial
from itertools import chain
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxgrasp.model.arrays import AnyArray, Float
from jaxgrasp.model.faults import entries as faults_in
from jaxgrasp.model.grasp import Grasp
from jaxgrasp.model.solution import is_known
from jaxgrasp.model.task import Task
from jaxgrasp.numerics.compiled_code import compile_quickly_options, traced_for_here
from jaxgrasp.sensitivity.matrix import SensitivityMatrix, named_outputs
from jaxgrasp.sensitivity.naming import (
    Entry,
    Labels,
    as_arrays,
    check_finite,
    check_labels,
    chosen,
    entries_of,
    row_of,
    values_at,
    with_values,
)
from jaxgrasp.validation.checked import checked

MOST_SHOWN = 4
"""Outputs, and parameters, that ``print`` shows."""
OutputOf = Callable[[Grasp, Array], Any]


class VariedCurves(eqx.Module):
    """Curves for several values of one parameter, as they are and as the nominal curve's derivatives foresee them."""

    values: Float[Array, "V"]
    curves: Float[Array, "V T M"]
    predicted: Float[Array, "V T M"]
    """Nominal curve and derivative times the change of the parameter."""

    @property
    def error(self) -> Float[Array, "V T M"]:
        """Error of the prediction, in the output's unit; zero where both are the same, infinite ones too."""
        return jnp.where(self.predicted == self.curves, 0, self.predicted - self.curves)


class SensitivityTrajectory(eqx.Module):
    """Outputs along a task, and their derivatives by parameters."""

    times: Float[Array, "T"]
    """[s]"""
    matrix: SensitivityMatrix
    """Nominal curves and their derivatives, of leading axis T: ``nominal`` (T, M) and ``derivatives`` (T, M, P)."""
    varied: dict[str, VariedCurves]
    """Varied curves, by the name of the parameter that was varied."""

    @property
    def curves(self) -> Float[Array, "T M"]:
        """Nominal curves of the outputs over the times, one column for each of ``matrix.output_labels``."""
        return self.matrix.nominal

    def __str__(self) -> str:
        """Times, the range of each output, and the parameters of most influence, in some ten lines."""
        if not all(map(is_known, jax.tree.leaves(self))):
            return repr(self)
        times, curves = np.asarray(self.times), np.asarray(self.curves)
        lines = [
            f"SensitivityTrajectory of {curves.shape[1]} outputs by {len(self.matrix.parameters)} parameters, "
            f"{len(times)} times from {times[0]:g} to {times[-1]:g} s"
        ]
        for label, entry, curve in list(zip(self.matrix.output_labels, self.matrix.outputs, curves.T))[:MOST_SHOWN]:
            known = curve[~np.isnan(curve)]
            extremes = f"{known.min():.4g} to {known.max():.4g}" if known.size else "none"
            lines.append(f"  {label}: {extremes}{f' {entry.unit}' if entry.unit else ''}")
        if curves.shape[1] > MOST_SHOWN:
            lines.append(f"  ... {curves.shape[1] - MOST_SHOWN} more outputs")
        strongest = [f"{one.label} {one.size:.3g}" for one in self.matrix.ranking()[:MOST_SHOWN]]
        if strongest:
            lines.append(f"  influence of parameters by their size: {', '.join(strongest)}")
        for name, varied in self.varied.items():
            lines.append(f"  varied: {name} = {', '.join(f'{value:g}' for value in np.asarray(varied.values))}")
        return "\n".join(lines)


@checked
def sensitivity_trajectory(
    task: Task,
    times: Float[AnyArray, "T"] | Sequence[float],
    output: OutputOf,
    by: Iterable[str] | None = None,
    *,
    vary: Mapping[str, Sequence[float]] | None = None,
    labels: Labels | None = None,
) -> SensitivityTrajectory:
    """Curves of an output along a task, their derivatives by the task's parameters, and varied curves.

    One compiled program does all times and all parameters, and is run again for each varied value; the derivatives are
    forward or reverse ones, whichever are fewer at one time.

    Args:
        task: grasp and wrench over time.
        times: ascending ``(T,)`` [s].
        output: (grasp, wrench) -> an array or a tree of arrays, for the leading axis of the times: an
            [`jaxgrasp.sensitivity.Output`][], a function such as [`jaxgrasp.least_squeeze`][], or one of your own. What
            it says of an instant must depend on that instant alone, so no sums over time. Let it be one function
            for all calls, not made anew for each.
        by: names of parameters, as for [`jaxgrasp.sensitivity.sensitivity_matrix`][]; all of the task's by default.
        vary: values to try, by the name of a parameter, such as ``{"contributions[1]": (0.5, 1.0, 2.0)}``; an array's
            name stands for all of its entries at once.
        labels: as for [`jaxgrasp.sensitivity.sensitivity_matrix`][].

    Returns:
        A SensitivityTrajectory.

    Raises:
        ValueError: for times that do not ascend, names that are unknown, parameters that are not finite, a task that
            returns no grasp and wrench, and an output that lacks the axis of the times.
    """
    return trajectory_call(task, times, output, by, vary=vary, labels=labels)()


def trajectory_call(
    task: Task,
    times: AnyArray | Sequence[float],
    output: OutputOf,
    by: Iterable[str] | None = None,
    *,
    vary: Mapping[str, Sequence[float]] | None = None,
    labels: Labels | None = None,
    once: bool = False,
) -> Callable[[], SensitivityTrajectory]:
    """What gives the trajectory, once the arguments are known to be good; calls of several may run side by side.

    Args:
        task, times, output, by, vary, labels: as for [`jaxgrasp.sensitivity.sensitivity_trajectory`][], as are errors.
        once: whether to compile quickly, to slower code.
    """
    instants = read_times(times)
    task = as_arrays(task)
    entries = entries_of(task.parameters, labels)
    wanted = chosen(entries, by)
    check_finite(task.parameters, wanted)
    outputs = outputs_of(task, output, instants, labels)
    check_labels(labels, (*entries, *outputs))
    tried = tuple(chosen(entries, [name]) for name in vary or {})
    values = tuple(jnp.asarray(_read_row(f"values of {name}", these)) for name, these in (vary or {}).items())
    together = tuple(dict.fromkeys((*wanted, *chain(*tried))))
    forward = len(together) <= len(outputs)

    def call() -> SensitivityTrajectory:
        # One program for the nominal and all varied curves: what it takes to compile would last for many calls of it.
        found = partial(_program(forward, once), task, output, instants, together)
        here = jnp.asarray(values_at(task.parameters, together, np))
        nominal, derivatives = found(here)
        matrix = SensitivityMatrix(derivatives, nominal, here, outputs, together)
        varied = {}
        for name, these, each in zip(vary or {}, tried, values, strict=True):
            curves = jnp.stack([found(jnp.asarray(row))[0] for row in _varied_rows(matrix, these, each)])
            varied[name] = VariedCurves(each, curves, _predicted(matrix, these, each))
        if together != wanted:
            kept = slice(len(wanted))
            matrix = SensitivityMatrix(derivatives[..., kept], nominal, matrix.values[kept], outputs, wanted)
        return SensitivityTrajectory(instants, matrix, varied)

    return call


def _varied_rows(matrix: SensitivityMatrix, entries: Sequence[Entry], values: Array) -> np.ndarray:
    """``(V, P)``: all parameters, these with one value after another."""
    rows = np.repeat(np.asarray(matrix.values)[None], len(values), 0)
    rows[:, _columns(matrix, entries)] = np.asarray(values)[:, None]
    return rows


def _predicted(matrix: SensitivityMatrix, entries: Sequence[Entry], values: Array) -> Array:
    columns = _columns(matrix, entries)
    moved = values[:, None] - matrix.values[columns]
    return matrix.nominal + jnp.einsum("tmk,vk->vtm", matrix.derivatives[..., columns], moved)


def _columns(matrix: SensitivityMatrix, entries: Sequence[Entry]) -> np.ndarray:
    return np.array([matrix.parameters.index(entry) for entry in entries])


@cache
def _program(forward: bool, once: bool) -> Callable[..., tuple[Array, Array]]:
    """Curves and their derivatives, at some values of the wanted parameters."""
    options: dict[str, Any] = {"compiler_options": compile_quickly_options()} if once else {}
    return eqx.filter_jit(traced_for_here(_forward if forward else _reverse), **options)


def _curves(task: Task, output: OutputOf, times: Array, parameters: Any, axis: int | None = None) -> Array:
    """``(T, M)``; the solvers get all times as one batch."""
    return row_of(named_outputs(output, output(*jax.vmap(task.at, (axis, 0))(parameters, times))), 1)


def _forward(task: Task, output: OutputOf, times: Array, wanted: Sequence[Entry], here: Array) -> tuple[Array, Array]:
    def curves(values: Array) -> tuple[Array, Array]:
        found = _curves(task, output, times, with_values(task.parameters, wanted, values))
        return found, found

    derivatives, nominal = jax.jacfwd(curves, has_aux=True)(here)
    return nominal, derivatives


def _reverse(task: Task, output: OutputOf, times: Array, wanted: Sequence[Entry], here: Array) -> tuple[Array, Array]:
    """With parameters of its own for each time, one pull gives an output's gradients at all times."""
    put = jax.vmap(lambda values: with_values(task.parameters, wanted, values))
    each = jnp.broadcast_to(here, (times.size, here.size))
    nominal, pull = jax.vjp(lambda values: _curves(task, output, times, put(values), 0), each)
    rows = jax.vmap(lambda one: pull(jnp.broadcast_to(one, nominal.shape))[0])(jnp.eye(nominal.shape[1]))
    return nominal, jnp.moveaxis(rows, 0, 1)


def read_times(times: AnyArray | Sequence[float]) -> Array:
    array = _read_row("times", times, "a finite number of seconds")
    for k in np.flatnonzero(np.diff(array) <= 0):
        raise ValueError(f"times[{k + 1}] is {array[k + 1]:g}: expected more than times[{k}], {array[k]:g}")
    return jnp.asarray(array)


def _read_row(name: str, numbers: AnyArray | Sequence[float], expected: str = "a finite number") -> np.ndarray:
    array = np.asarray(numbers, float)
    if array.ndim != 1 or not array.size:
        raise ValueError(f"{name} has shape {array.shape}: expected one axis, and one entry at least")
    for fault in faults_in(name, array, ~np.isfinite(array), expected):
        raise ValueError(str(fault))
    return array


def outputs_of(task: Task, output: OutputOf, times: Array, labels: Labels | None) -> tuple[Entry, ...]:
    """The outputs at one time, once task and output are known to return what they should."""
    leaves, structure = jax.tree.flatten(task.parameters)
    shapes = tuple(jax.ShapeDtypeStruct(leaf.shape, leaf.dtype) if hasattr(leaf, "dtype") else leaf for leaf in leaves)
    asked = (task.at, output, structure, shapes, times.shape, times.dtype)
    try:
        hash(asked)
    except TypeError:
        # A Module that holds arrays is no key.
        return entries_of(_shapes.__wrapped__(*asked), labels)
    return entries_of(_shapes(*asked), labels)


@lru_cache(256)
def _shapes(at: Callable, output: OutputOf, structure: Any, shapes: tuple, instants: tuple[int], dtype: Any) -> Any:
    """Shapes of the outputs at one time; kept, since tracing task and output takes as long as running them."""
    parameters = jax.tree.unflatten(structure, shapes)
    _check_returned(jax.eval_shape(at, parameters, jax.ShapeDtypeStruct((), dtype)))
    batch = jax.eval_shape(jax.vmap(at, (None, 0)), parameters, jax.ShapeDtypeStruct(instants, dtype))
    found = named_outputs(output, jax.eval_shape(output, *batch))
    for leaf in jax.tree.leaves(found):
        if leaf.shape[:1] != instants:
            raise ValueError(f"the output has shape {leaf.shape}: expected the axis of the {instants[0]} times first")
    return jax.tree.map(lambda leaf: jax.ShapeDtypeStruct(leaf.shape[1:], leaf.dtype), found)


def _check_returned(made: Any) -> None:
    """Raise ValueError unless a task returned a grasp and a wrench."""
    if not (isinstance(made, tuple) and len(made) == 2 and isinstance(made[0], Grasp)):
        kinds = ", ".join(type(part).__name__ for part in made) if isinstance(made, tuple) else type(made).__name__
        raise ValueError(f"the task returns ({kinds}): expected a Grasp and a wrench")
    grasp, wrench = made
    n = np.shape(grasp.friction)[-1:]
    expected = {"points": (*n, 3), "normals": (*n, 3), "friction": n, "squeeze": n}
    shapes = {f"grasp's {name}": (np.shape(getattr(grasp, name)), shape) for name, shape in expected.items()}
    for name, (shape, wanted) in {**shapes, "wrench": (np.shape(wrench), (6,))}.items():
        if shape != wanted:
            raise ValueError(f"the task's {name} has shape {shape}: expected {wanted}")
