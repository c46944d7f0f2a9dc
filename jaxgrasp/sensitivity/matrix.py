"""The sensitivity matrix: how any outputs move with any parameters (section II-G.3)."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxgrasp.model.arrays import Float
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

Mode = Literal["forward", "reverse"]


class Influence(NamedTuple):
    """What a parameter counts for, beside the others."""

    label: str
    size: float
    """Root mean square, over all outputs, of how far one spread of the parameter moves them, relative to their own
    root mean square."""


class SensitivityMatrix(eqx.Module):
    """Derivatives of outputs by parameters, with what they are called; leading axes are instants or other cases."""

    derivatives: Float[Array, "*batch M P"]
    """In the output's unit per the parameter's."""
    nominal: Float[Array, "*batch M"]
    """The outputs where the derivatives were taken."""
    values: Float[Array, "P"]
    """The parameters there."""
    outputs: tuple[Entry, ...] = eqx.field(static=True)
    parameters: tuple[Entry, ...] = eqx.field(static=True)

    @property
    def output_labels(self) -> tuple[str, ...]:
        """What the rows are called."""
        return tuple(entry.label for entry in self.outputs)

    @property
    def parameter_labels(self) -> tuple[str, ...]:
        """What the columns are called."""
        return tuple(entry.label for entry in self.parameters)

    def relative(self) -> Float[Array, "*batch M P"]:
        """Elasticities: by how many per cent an output moves for one per cent of a parameter.

        Zero where the parameter is zero or does nothing; infinite where an output that is zero moves.
        """
        moves = self.derivatives * self.values
        nominal = self.nominal[..., None]
        safe = jnp.where(nominal == 0, 1, nominal)
        return jnp.where(moves == 0, 0, jnp.where(nominal == 0, jnp.sign(moves) * jnp.inf, moves / safe))

    def ranking(self, spreads: Mapping[str, float] | None = None, *, together: bool = False) -> list[Influence]:
        """The parameters by their influence, the largest first.

        What has no derivative (NaN), as forces where none hold the load, is left out; where nothing is left the
        influence is NaN.

        Args:
            spreads: how far a parameter is thought to vary, in its own unit, by its own name or its array's; where
                none is given, by its own size, so that what is zero has no influence.
            together: an array's entries as one, which vary independently of each other.

        Raises:
            ValueError: for a spread of something that is no parameter here.
        """
        sizes = np.sqrt(np.sum(self._shares(_spreads(self, spreads or {})) ** 2, 0))
        sums: dict[str, float] = {}
        for entry, size in zip(self.parameters, sizes, strict=True):
            label = entry.name if together else entry.label
            sums[label] = sums.get(label, 0.0) + float(size) ** 2
        found = [Influence(label, float(np.sqrt(total))) for label, total in sums.items()]
        return sorted(found, key=lambda one: -one.size)

    def _shares(self, spreads: np.ndarray) -> np.ndarray:
        """``(groups of outputs, P)``: each group's own root mean square move, by its own root mean square size."""
        nominal = np.asarray(self.nominal).reshape(-1, len(self.outputs))
        moves = np.asarray(self.derivatives).reshape(-1, *self.derivatives.shape[-2:]) * spreads
        names = np.array([entry.name for entry in self.outputs])
        groups = [names == name for name in dict.fromkeys(names)]
        known = ~np.isnan(moves).any(-1)
        # What has no size, as the slip angle where there is no force, does not move either.
        finite = np.where(np.isfinite(nominal), nominal, 0)
        sizes = [_root_mean_square(finite[:, group][known[:, group]]) for group in groups]
        rows = [_root_mean_square(moves[:, group][known[:, group]]) / (size or 1) for group, size in zip(groups, sizes)]
        return np.array(rows) / np.sqrt(len(groups))

    def columns(self) -> dict[str, np.ndarray]:
        """What a CSV file holds: a row for every pair of output and parameter, leading axes flattened."""
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
    """How the outputs of a function move with its parameters, by automatic differentiation.

    Args:
        f: parameters -> outputs: an array, or a tree of arrays such as ``{"forces": ..., "slip_angle": ...}``. Any of
            this package's functions will do, from a hand's joints to margins and joint torques. It is compiled: let it
            be one function for all calls, not made anew for each.
        parameters: numbers and arrays in dicts, tuples or Modules: a [`jaxgrasp.Grasp`][], a
            [`jaxgrasp.grip.HeldCylinder`][], a [`jaxgrasp.hand.Posture`][], or ``{"mass": 0.4, "friction": ...}``.
        by: names of the parameters to differentiate by, such as ``("friction", "points[0, 2]")``; all where not given.
        labels: of the entries of arrays along their first axis, by the array's name, parameters and outputs alike:
            ``{"contributions": ("thumb", "index", "middle", "ring", "little")}``.
        mode: of differentiation; where not given, forward if there are no more parameters than outputs, else reverse.

    Returns:
        A SensitivityMatrix.

    Raises:
        ValueError: for a name that is unknown, with the one most like it, parameters that are not finite, labels that
            do not fit, and another mode.
    """
    parameters = as_arrays(parameters)
    entries = entries_of(parameters, labels)
    wanted = chosen(entries, by)
    if mode not in (None, "forward", "reverse"):
        raise ValueError(f"mode is {mode!r}: expected 'forward', 'reverse' or None")
    check_finite(parameters, wanted)
    outputs = entries_of(named_outputs(f, jax.eval_shape(f, parameters)), labels)
    check_labels(labels, (*entries, *outputs))
    if not outputs:
        raise ValueError("the function returns no floating-point arrays, which alone have derivatives")
    forward = len(wanted) <= len(outputs) if mode is None else mode == "forward"
    here, nominal, derivatives = _differentiated(f, wanted, forward, parameters)
    return SensitivityMatrix(derivatives, nominal, here, outputs, wanted)


@eqx.filter_jit
def _differentiated(f: Callable, wanted: Sequence[Entry], forward: bool, parameters: Any) -> tuple[Array, Array, Array]:
    def flat(values: Array) -> tuple[Array, Array]:
        found = row_of(named_outputs(f, f(with_values(parameters, wanted, values))))
        return found, found

    here = values_at(parameters, wanted)
    derivatives, nominal = (jax.jacfwd if forward else jax.jacrev)(flat, has_aux=True)(here)
    return here, nominal, derivatives


def named_outputs(f: Callable, outputs: Any) -> Any:
    """Outputs that are one array are called by the function's name."""
    if isinstance(outputs, jax.Array | np.ndarray | jax.ShapeDtypeStruct):
        return {getattr(f, "__name__", "output").replace("<lambda>", "output"): outputs}
    return outputs


def _root_mean_square(values: np.ndarray) -> np.ndarray | np.float64:
    """Root mean square of each column; NaN where there are no rows at all."""
    return np.sqrt(np.sum(values**2, 0) / (len(values) or np.nan))


def _spreads(matrix: SensitivityMatrix, given: Mapping[str, float]) -> np.ndarray:
    """By parameter; the spread of an entry goes before that of its array."""
    sizes = np.abs(np.asarray(matrix.values))
    meant = {name: chosen(matrix.parameters, [name]) for name in given}
    for name in sorted(given, key=lambda name: -len(meant[name])):
        if not (np.ndim(given[name]) == 0 and np.isfinite(given[name])):
            raise ValueError(f"the spread of {name} is {given[name]!r}: expected a finite number")
        sizes[[matrix.parameters.index(entry) for entry in meant[name]]] = given[name]
    return sizes
