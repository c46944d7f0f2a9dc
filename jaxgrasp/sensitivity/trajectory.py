"""Sensitivity trajectories: outputs over time along a task, their derivatives, and varied curves (section II-G.3)."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import chain
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxgrasp.force.distribution import closed_form, constrained_optimum
from jaxgrasp.force.least_friction import least_friction
from jaxgrasp.force.slip import friction_margin, slip_angle, stability_margin
from jaxgrasp.model.arrays import AnyArray, Bool, Float
from jaxgrasp.model.faults import entries as issues_in
from jaxgrasp.model.grasp import Grasp
from jaxgrasp.model.solution import Solution, is_known, methods_named
from jaxgrasp.model.task import Task
from jaxgrasp.numerics.compiled_code import compile_quickly_options, traced_for_here
from jaxgrasp.numerics.no_derivative import nondifferentiable_where
from jaxgrasp.sensitivity.matrix import SensitivityMatrix, derivatives_by_rows, named_outputs
from jaxgrasp.sensitivity.naming import (
    Entry,
    FixedParts,
    Labels,
    as_arrays,
    check_finite,
    check_labels,
    entries_of,
    row_of,
    select_entries,
    split_arrays,
    values_at,
    with_values,
)
from jaxgrasp.validation.checked import checked

MOST_SHOWN = 4
"""Number of outputs, and of parameters, that ``print`` shows."""
OutputOf = Callable[[Grasp, Array], Any]


class VariedCurves(eqx.Module):
    """Curves for several values of a parameter, exact and as predicted by the nominal curve's derivatives."""

    values: Float[Array, "V"]
    curves: Float[Array, "V T M"]
    predicted: Float[Array, "V T M"]
    """Nominal curve plus derivative times the change of the parameter."""

    @property
    def error(self) -> Float[Array, "V T M"]:
        """Return the error of the prediction, in the output's unit; zero where both are equal, infinite values too."""
        return jnp.where(self.predicted == self.curves, 0, self.predicted - self.curves)


class SensitivityTrajectory(eqx.Module):
    """Outputs along a task, and their derivatives by parameters."""

    times: Float[Array, "T"]
    """[s]"""
    matrix: SensitivityMatrix
    """Nominal curves and their derivatives, of leading axis T: ``nominal`` (T, M) and ``derivatives`` (T, M, P)."""
    varied: dict[str, VariedCurves]
    """Varied curves, by the name of the varied parameter."""

    @property
    def curves(self) -> Float[Array, "T M"]:
        """Return the nominal curves of the outputs over the times, a column for each of ``matrix.output_labels``."""
        return self.matrix.nominal

    def __str__(self) -> str:
        """Summarise times, the range of each output, and the most influential parameters, in some ten lines."""
        if not all(map(is_known, jax.tree.leaves(self))):
            return repr(self)
        times, curves = np.asarray(self.times), np.asarray(self.curves)
        lines = [
            f"SensitivityTrajectory of {curves.shape[1]} outputs by {len(self.matrix.parameters)} parameters, "
            f"{len(times)} times from {times[0]:g} to {times[-1]:g} s"
        ]
        for label, entry, curve in list(zip(self.matrix.output_labels, self.matrix.outputs, curves.T))[:MOST_SHOWN]:
            valid = curve[~np.isnan(curve)]
            extremes = f"{valid.min():.4g} to {valid.max():.4g}" if valid.size else "none"
            lines.append(f"  {label}: {extremes}{f' {entry.unit}' if entry.unit else ''}")
        if curves.shape[1] > MOST_SHOWN:
            lines.append(f"  ... {curves.shape[1] - MOST_SHOWN} more outputs")
        strongest = [f"{influence.label} {influence.size:.3g}" for influence in self.matrix.ranking()[:MOST_SHOWN]]
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
    """Compute curves of an output along a task, their derivatives by the task's parameters, and varied curves.

    One compiled program evaluates all times and all parameters, and is run again for each varied value; the derivatives
    are forward or reverse ones, whichever are fewer at one time.

    Args:
        task: grasp and wrench over time.
        times: ascending ``(T,)`` [s].
        output: (grasp, wrench) -> an array or a tree of arrays, for the leading axis of the times: an
            [`jaxgrasp.sensitivity.Output`][], a function such as [`jaxgrasp.least_squeeze`][], or one of your own. Its
            value at an instant must depend on that instant alone, so no sums over time. Pass the same function in all
            calls, not a new one in each.
        by: names of parameters, as for [`jaxgrasp.sensitivity.sensitivity_matrix`][]; all of the task's by default.
        vary: values for varied curves, by the name of a parameter, such as ``{"contributions[1]": (0.5, 1.0, 2.0)}``;
            an array's name stands for all of its entries at once.
        labels: as for [`jaxgrasp.sensitivity.sensitivity_matrix`][].

    Returns:
        A SensitivityTrajectory.

    Raises:
        ValueError: for times that do not ascend, unknown names, parameters that are not finite, a task that does not
            return a grasp and a wrench, and an output without the axis of the times.
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
    """Check the arguments, and return the function that computes the trajectory; several such calls may run in
    parallel.

    Args:
        task, times, output, by, vary, labels: as for [`jaxgrasp.sensitivity.sensitivity_trajectory`][], as are errors.
        once: whether to compile quickly, to slower code.
    """
    instants = read_times(times)
    task = as_arrays(task)
    entries = entries_of(task.parameters, labels)
    selected = select_entries(entries, by)
    check_finite(task.parameters, selected)
    varied_entries = tuple(select_entries(entries, [name]) for name in vary or {})
    values = tuple(jnp.asarray(_read_row(f"values of {name}", numbers)) for name, numbers in (vary or {}).items())
    differentiated = tuple(dict.fromkeys((*selected, *chain(*varied_entries))))
    # One program for the nominal and all varied curves: compiling takes as long as many calls of it.
    arrays, fixed = split_arrays((task, output))
    point = jnp.asarray(values_at(task.parameters, differentiated, np))
    program, fixed_arguments = _program(once), (fixed, differentiated, arrays, instants)
    # The calls below find this trace, which takes as long as running them.
    *_, shapes = program.trace(*fixed_arguments, point).out_info
    outputs = entries_of(_at_one_time(shapes), labels)
    check_labels(labels, (*entries, *outputs))

    def call() -> SensitivityTrajectory:
        nominal, derivatives, _ = program(*fixed_arguments, point)
        matrix = SensitivityMatrix(derivatives, nominal, point, outputs, differentiated)
        varied = {}
        for name, numbers, row_values in zip(vary or {}, varied_entries, values, strict=True):
            rows = _varied_rows(matrix, numbers, row_values)
            curves = np.stack([np.asarray(program(*fixed_arguments, jnp.asarray(row))[0]) for row in rows])
            predicted = _predicted(matrix, numbers, np.asarray(row_values))
            varied[name] = VariedCurves(row_values, jnp.asarray(curves), jnp.asarray(predicted))
        if differentiated != selected:
            columns = slice(len(selected))
            matrix = SensitivityMatrix(derivatives[..., columns], nominal, matrix.values[columns], outputs, selected)
        return SensitivityTrajectory(instants, matrix, varied)

    return call


def _varied_rows(matrix: SensitivityMatrix, entries: Sequence[Entry], values: Array) -> np.ndarray:
    """Return rows ``(V, P)`` of all parameters, with these entries set to one value after the other."""
    rows = np.repeat(np.asarray(matrix.values)[None], len(values), 0)
    rows[:, _columns(matrix, entries)] = np.asarray(values)[:, None]
    return rows


def _predicted(matrix: SensitivityMatrix, entries: Sequence[Entry], values: np.ndarray) -> np.ndarray:
    columns = _columns(matrix, entries)
    change = values[:, None] - np.asarray(matrix.values)[columns]
    return np.asarray(matrix.nominal) + np.einsum("tmk,vk->vtm", np.asarray(matrix.derivatives)[..., columns], change)


def _columns(matrix: SensitivityMatrix, entries: Sequence[Entry]) -> np.ndarray:
    return np.array([matrix.parameters.index(entry) for entry in entries])


@cache
def _program(once: bool) -> jax.stages.Wrapped:
    """Compile curves and their derivatives as a function of the selected parameters."""
    options: dict[str, Any] = {"compiler_options": compile_quickly_options()} if once else {}
    return jax.jit(traced_for_here(_curves_and_derivatives), static_argnums=(0, 1), **options)


def _curves_and_derivatives(
    fixed: FixedParts, selected: tuple[Entry, ...], arrays: Sequence[Array], times: Array, point: Array
) -> tuple[Array, Array, Any]:
    """Compute the curves ``(T, M)``, their derivatives ``(T, M, P)``, and the output itself, for its structure.

    The parameters are separate ones for each time. The solvers get all times as one batch.
    """
    task, output = fixed.tree(arrays)
    put = jax.vmap(lambda values: with_values(task.parameters, selected, values))
    rows_of_parameters = jnp.broadcast_to(point, (times.size, point.size))

    def curves_of(values: Array) -> tuple[Array, Any]:
        returned = jax.vmap(task.at)(put(values), times)
        _check_returned(_at_one_time(returned))
        results = named_outputs(output, output(*returned))
        _check_times(results, times)
        return row_of(results, 1), results

    curves, push, results = jax.linearize(curves_of, rows_of_parameters, has_aux=True)
    return curves, derivatives_by_rows(push, rows_of_parameters, curves, None), results


def read_times(times: AnyArray | Sequence[float]) -> Array:
    array = _read_row("times", times, "a finite number of seconds")
    for k in np.flatnonzero(np.diff(array) <= 0):
        raise ValueError(f"times[{k + 1}] is {array[k + 1]:g}: expected more than times[{k}], {array[k]:g}")
    return jnp.asarray(array)


def _read_row(name: str, numbers: AnyArray | Sequence[float], expected: str = "a finite number") -> np.ndarray:
    array = np.asarray(numbers, float)
    if array.ndim != 1 or not array.size:
        raise ValueError(f"{name} has shape {array.shape}: expected one axis with at least one entry")
    for issue in issues_in(name, array, ~np.isfinite(array), expected):
        raise ValueError(str(issue))
    return array


def outputs_of(task: Task, output: OutputOf, times: Array, labels: Labels | None) -> tuple[Entry, ...]:
    """List the outputs at one time, after checks of the shapes that task and output return."""
    returned = jax.eval_shape(jax.vmap(task.at, (None, 0)), task.parameters, times)
    _check_returned(_at_one_time(returned))
    results = named_outputs(output, jax.eval_shape(output, *returned))
    _check_times(results, times)
    return entries_of(_at_one_time(results), labels)


def _check_times(results: Any, times: Array) -> None:
    """Raise ValueError unless every array of an output has the axis of the times first."""
    for leaf in jax.tree.leaves(results):
        if leaf.shape[:1] != times.shape:
            raise ValueError(f"the output has shape {leaf.shape}: expected the axis of the {times.size} times first")


def _at_one_time(results: Any) -> Any:
    """Return the shapes without the axis of the times."""
    return jax.tree.map(lambda leaf: jax.ShapeDtypeStruct(leaf.shape[1:], leaf.dtype), results)


def _check_returned(returned: Any) -> None:
    """Raise ValueError unless a task returned a grasp and a wrench."""
    if not (isinstance(returned, tuple) and len(returned) == 2 and isinstance(returned[0], Grasp)):
        kinds = (
            ", ".join(type(part).__name__ for part in returned)
            if isinstance(returned, tuple)
            else type(returned).__name__
        )
        raise ValueError(f"the task returns ({kinds}): expected a Grasp and a wrench")
    grasp, wrench = returned
    n = np.shape(grasp.friction)[-1:]
    expected = {"points": (*n, 3), "normals": (*n, 3), "friction": n, "squeeze": n}
    shapes = {f"grasp's {name}": (np.shape(getattr(grasp, name)), shape) for name, shape in expected.items()}
    for name, (shape, expected_shape) in {**shapes, "wrench": (np.shape(wrench), (6,))}.items():
        if shape != expected_shape:
            raise ValueError(f"the task's {name} has shape {shape}: expected {expected_shape}")


QUANTITIES: dict[str, Callable[[Grasp, Solution], Array]] = {
    "forces": lambda grasp, solution: solution.forces,
    "slip_angle": lambda grasp, solution: slip_angle(grasp, solution.forces),
    "stability_margin": lambda grasp, solution: stability_margin(grasp, solution.forces),
    "friction_margin": lambda grasp, solution: friction_margin(grasp, solution.forces, solution.moments),
    "objective": lambda grasp, solution: solution.objective,
}


class FrictionReserve(NamedTuple):
    """Reserve of friction of a grasp."""

    reserve: Float[Array, "*batch"]
    """Friction over the least sufficient friction; below 1 it is insufficient, +inf where hardly any is needed."""


@checked
def friction_reserve(grasp: Grasp, wrench: Float[AnyArray, "*batch 6"]) -> FrictionReserve:
    """Compute the factor by which friction exceeds the least sufficient one, at the normal forces that the hand means
    to exert in total.

    It ranks optima, whose active contacts have no margin left however large their reserve: it is the inverse of
    [`jaxgrasp.least_friction`][]. Below 1 the friction is insufficient; +inf where hardly any is needed, and 0 where no
    friction suffices. Both are constant in the data; 0 has no derivative (NaN).
    """
    share = least_friction(grasp, wrench)
    bounded = (share > 0) & jnp.isfinite(share)
    reserve = jnp.where(bounded, 1 / jnp.where(bounded, share, 1), jnp.where(share > 0, 0, jnp.inf))
    return FrictionReserve(nondifferentiable_where(jnp.isinf(share), reserve, share))


@dataclass(frozen=True)
class Output:
    """Function of (grasp, wrench) that returns one quantity by one method, for any leading axes.

    Equal ones are compiled once.

    Args:
        quantity: ``"forces"`` ``(n, 3)`` [N]; ``"slip_angle"``, ``"stability_margin"`` or ``"friction_margin"``
            ``(n,)`` [rad]; or ``"objective"``, one number, F_2 [N^2] (eq. 5) of A and F_3 [N] (eq. 13) of B.
        method: ``"A"`` or ``"B"`` for the closed form, ``"A-optimum"`` or ``"B-optimum"`` for the constrained optimum
            by the same sharing.

    Raises:
        ValueError: for an unknown quantity or method.
    """

    quantity: str
    """``forces`` [N], ``slip_angle``, ``stability_margin`` or ``friction_margin`` [rad], or ``objective``."""
    method: str = "B"
    """A or B for the closed form, A-optimum or B-optimum for the constrained optimum by the same sharing."""

    def __post_init__(self):
        if self.quantity not in QUANTITIES:
            raise ValueError(f"quantity {self.quantity!r} is unknown: expected one of {', '.join(QUANTITIES)}")
        methods_named((self.method,))

    def __call__(self, grasp: Grasp, wrench: Float[AnyArray, "*batch 6"]) -> dict[str, Any]:
        """Return the quantity, by its name."""
        (method,) = methods_named((self.method,))
        solve = constrained_optimum if method.constrained else closed_form
        return {self.quantity: QUANTITIES[self.quantity](grasp, solve(grasp, wrench, method.sharing))}


class SlipAngles(eqx.Module):
    """Function of (grasp, wrench) that returns slip angles, for any leading axes; both sharings are one program."""

    by_squeeze: Bool[AnyArray, ""]
    """True if squeezing forces are the weights, False for weights of 1."""
    constrained: bool = eqx.field(static=True)

    @classmethod
    def by(cls, method: str) -> "SlipAngles":
        """Build the function for a method's forces."""
        (named,) = methods_named((method,))
        return cls(np.asarray(named.sharing == "squeeze"), named.constrained)

    def __call__(self, grasp: Grasp, wrench: Float[AnyArray, "*batch 6"]) -> dict[str, Array]:
        """Return ``slip_angle`` [rad]."""
        squeeze = jnp.asarray(grasp.squeeze)
        weights = jnp.where(self.by_squeeze, squeeze, jnp.ones_like(squeeze))
        solve = constrained_optimum if self.constrained else closed_form
        return {"slip_angle": slip_angle(grasp, solve(grasp, wrench, weights).forces)}
