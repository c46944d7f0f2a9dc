"""The sensitivity matrix: derivatives of any outputs by any parameters (section II-G.3)."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from typing import Any, Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxgrasp.model.arrays import Float
from jaxgrasp.sensitivity.naming import (
    Entry,
    FixedParts,
    Labels,
    as_arrays,
    check_finite,
    check_labels,
    entries_of,
    is_number,
    row_of,
    select_entries,
    split_arrays,
    values_at,
    with_values,
)
from jaxgrasp.validation.checked import checked

Mode = Literal["forward", "reverse"]


class Influence(NamedTuple):
    """Influence of a parameter on the outputs, relative to other parameters."""

    label: str
    size: float
    """Root mean square, over all outputs, of their change for one spread of the parameter, relative to their own root
    mean square."""


class SensitivityMatrix(eqx.Module):
    """Derivatives of outputs by parameters, with their labels; leading axes are instants or other cases."""

    derivatives: Float[Array, "*batch M P"]
    """Derivatives, in the output's unit per the parameter's unit."""
    nominal: Float[Array, "*batch M"]
    """Outputs at the point of differentiation."""
    values: Float[Array, "P"]
    """Parameters at that point."""
    outputs: tuple[Entry, ...] = eqx.field(static=True)
    parameters: tuple[Entry, ...] = eqx.field(static=True)

    @property
    def output_labels(self) -> tuple[str, ...]:
        """Return the labels of the rows."""
        return tuple(entry.label for entry in self.outputs)

    @property
    def parameter_labels(self) -> tuple[str, ...]:
        """Return the labels of the columns."""
        return tuple(entry.label for entry in self.parameters)

    def relative(self) -> Float[Array, "*batch M P"]:
        """Compute elasticities, (dy/dp) p / y: the change of an output in per cent for one per cent of a parameter.

        Zero where the parameter is zero or has no effect; infinite where an output of zero changes.
        """
        moves = self.derivatives * self.values
        nominal = self.nominal[..., None]
        safe = jnp.where(nominal == 0, 1, nominal)
        return jnp.where(moves == 0, 0, jnp.where(nominal == 0, jnp.sign(moves) * jnp.inf, moves / safe))

    def ranking(self, spreads: Mapping[str, float] | None = None, *, together: bool = False) -> list[Influence]:
        """Rank the parameters by their influence, the largest first.

        Outputs without a derivative (NaN), such as forces where none hold the load, are left out; where none remain the
        influence is NaN.

        Args:
            spreads: expected variation of a parameter, in its own unit, by its own name or its array's; its own size
                where not given, so that a parameter of zero has no influence.
            together: whether the entries of an array, which vary independently of each other, count as one.

        Raises:
            ValueError: for a spread of an unknown parameter.
        """
        sizes = np.sqrt(np.sum(self._shares(_spreads(self, spreads or {})) ** 2, 0))
        sums: dict[str, float] = {}
        for entry, size in zip(self.parameters, sizes, strict=True):
            label = entry.name if together else entry.label
            sums[label] = sums.get(label, 0.0) + float(size) ** 2
        influences = [Influence(label, float(np.sqrt(total))) for label, total in sums.items()]
        return sorted(influences, key=lambda influence: -influence.size)

    def _shares(self, spreads: np.ndarray) -> np.ndarray:
        """Compute ``(groups of outputs, P)``: root mean square change of each group, relative to its root mean square
        size."""
        nominal = np.asarray(self.nominal).reshape(-1, len(self.outputs))
        moves = np.asarray(self.derivatives).reshape(-1, *self.derivatives.shape[-2:]) * spreads
        names = np.array([entry.name for entry in self.outputs])
        groups = [names == name for name in dict.fromkeys(names)]
        is_known = ~np.isnan(moves).any(-1)
        # An output without size, such as the slip angle without force, does not change either.
        finite = np.where(np.isfinite(nominal), nominal, 0)
        sizes = [_root_mean_square(finite[:, group][is_known[:, group]]) for group in groups]
        rows = [
            _root_mean_square(moves[:, group][is_known[:, group]]) / (size or 1) for group, size in zip(groups, sizes)
        ]
        return np.array(rows) / np.sqrt(len(groups))

    def columns(self) -> dict[str, np.ndarray]:
        """Return the columns of a CSV file: a row for every pair of output and parameter, leading axes flattened."""
        shape = self.derivatives.shape
        cases = int(np.prod(shape[:-2]))
        pairs = [(output, parameter) for _ in range(cases) for output in self.outputs for parameter in self.parameters]
        units = [f"{output.unit or '1'} per {parameter.unit or '1'}" for output, parameter in pairs]
        return {
            "output": np.array([output.label for output, _ in pairs]),
            "parameter": np.array([parameter.label for _, parameter in pairs]),
            "nominal": np.repeat(np.asarray(self.nominal).ravel(), shape[-1]),
            "value": np.tile(np.asarray(self.values), cases * shape[-2]),
            "derivative": np.asarray(self.derivatives).ravel(),
            "unit": np.array(units),
            "relative": np.asarray(self.relative()).ravel(),
        }


@checked
def sensitivity_matrix(
    f: Callable[[Any], Any],
    parameters: Any,
    by: Iterable[str] | None = None,
    *,
    labels: Labels | None = None,
    mode: Mode | None = None,
) -> SensitivityMatrix:
    """Compute the derivatives of a function's outputs by its parameters, by automatic differentiation.

    Args:
        f: parameters -> outputs: an array, or a tree of arrays such as ``{"forces": ..., "slip_angle": ...}``. Any of
            this package's functions works, from a hand's joints to margins and joint torques. It is compiled: pass the
            same function in all calls, not a new one in each.
        parameters: numbers and arrays in dicts, tuples or Modules: a [`jaxgrasp.Grasp`][], a
            [`jaxgrasp.grip.HeldCylinder`][], a [`jaxgrasp.hand.Posture`][], or ``{"mass": 0.4, "friction": ...}``.
        by: names of the parameters to differentiate by, such as ``("friction", "points[0, 2]")``; all where not given.
        labels: labels of the entries of arrays along their first axis, by the array's name, parameters and outputs
            alike: ``{"contributions": ("thumb", "index", "middle", "ring", "little")}``.
        mode: mode of differentiation; where not given, forward if there are no more parameters than outputs, else
            reverse.

    Returns:
        A SensitivityMatrix.

    Raises:
        ValueError: for an unknown name, with the most similar one, parameters that are not finite, labels that do not
            fit, and an unknown mode.
    """
    parameters = as_arrays(parameters)
    entries = entries_of(parameters, labels)
    selected = select_entries(entries, by)
    if mode not in (None, "forward", "reverse"):
        raise ValueError(f"mode is {mode!r}: expected 'forward', 'reverse' or None")
    check_finite(parameters, selected)
    arrays, fixed = split_arrays((f, parameters))
    # Traced once, for the shapes and for the call.
    *_, shapes = _differentiated.trace(fixed, selected, mode, arrays).out_info
    outputs = entries_of(shapes, labels)
    check_labels(labels, (*entries, *outputs))
    nominal, derivatives, values, _ = _differentiated(fixed, selected, mode, arrays)
    return SensitivityMatrix(derivatives, nominal, values, outputs, selected)


@partial(jax.jit, static_argnums=(0, 1, 2))
def _differentiated(
    fixed: FixedParts, selected: tuple[Entry, ...], mode: Mode | None, arrays: Sequence[Array]
) -> tuple[Array, Array, Array, Any]:
    """Compute the numbers of the outputs, their derivatives by the selected parameters, these, and the outputs
    themselves, for their structure."""
    f, parameters = fixed.tree(arrays)

    def row(values: Array) -> tuple[Array, Any]:
        results = named_outputs(f, f(with_values(parameters, selected, values)))
        if not any(map(is_number, jax.tree.leaves(results))):
            raise ValueError(
                "the function returns no floating-point arrays: expected at least one, since only these have "
                "derivatives"
            )
        return row_of(results), results

    point = values_at(parameters, selected)
    nominal, push, results = jax.linearize(row, point, has_aux=True)
    return nominal, derivatives_by_rows(push, point, nominal, mode), point, results


def derivatives_by_rows(
    push: Callable[[Array], Array], rows: Float[Array, "*batch P"], outputs: Float[Array, "*batch M"], mode: Mode | None
) -> Float[Array, "*batch M P"]:
    """Compute the derivatives of outputs by a row of parameters, from the linear function between their changes.

    Outputs of an index of the leading axes depend on that index's row alone. ``mode`` is as for
    [`jaxgrasp.sensitivity.sensitivity_matrix`][].
    """
    parameters, numbers = rows.shape[-1], outputs.shape[-1]
    if mode == "forward" or (mode is None and parameters <= numbers):
        directions = jnp.eye(parameters, dtype=rows.dtype)
        return jax.vmap(lambda direction: push(jnp.broadcast_to(direction, rows.shape)), out_axes=-1)(directions)
    pull = jax.linear_transpose(push, rows)
    cotangents = jnp.eye(numbers, dtype=outputs.dtype)
    return jax.vmap(lambda row: pull(jnp.broadcast_to(row, outputs.shape))[0], out_axes=-2)(cotangents)


def named_outputs(f: Callable, outputs: Any) -> Any:
    """Name a single output array by its function."""
    if isinstance(outputs, jax.Array | np.ndarray | jax.ShapeDtypeStruct):
        return {getattr(f, "__name__", "output").replace("<lambda>", "output"): outputs}
    return outputs


def _root_mean_square(values: np.ndarray) -> np.ndarray | np.float64:
    """Compute the root mean square of each column; NaN for a matrix without rows."""
    return np.sqrt(np.sum(values**2, 0) / (len(values) or np.nan))


def _spreads(matrix: SensitivityMatrix, spreads: Mapping[str, float]) -> np.ndarray:
    """Return the spread of each parameter; that of an entry takes precedence over that of its array."""
    sizes = np.abs(np.asarray(matrix.values))
    entries = {name: select_entries(matrix.parameters, [name]) for name in spreads}
    for name in sorted(spreads, key=lambda name: -len(entries[name])):
        if not (np.ndim(spreads[name]) == 0 and np.isfinite(spreads[name])):
            raise ValueError(f"the spread of {name} is {spreads[name]!r}: expected a finite number")
        sizes[[matrix.parameters.index(entry) for entry in entries[name]]] = spreads[name]
    return sizes
