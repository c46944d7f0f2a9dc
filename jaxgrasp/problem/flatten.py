"""Flattens users' arguments of any leading axes into one batch in one precision; errors name the field."""

import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxgrasp.model.arrays import AnyArray
from jaxgrasp.model.grasp import Grasp, Limits
from jaxgrasp.problem.batch_last import ProblemBatch, TorqueBounds
from jaxgrasp.validation.checked import check_numbers

Sharing = str | AnyArray
SHARINGS = {"squeeze": "squeeze", "uniform": "uniform", "A": "uniform", "B": "squeeze"}
"""Names of sharings, the paper's methods among them, by the weights that they stand for."""


def read_sharing(sharing: Sharing) -> tuple[str, AnyArray | None]:
    """Return the name of a sharing's weights, and the weights of one that is given as such."""
    if isinstance(sharing, str):
        if sharing in SHARINGS:
            return SHARINGS[sharing], None
    elif sharing is not None:
        check_numbers("sharing", sharing)
        return "given", sharing
    raise ValueError(f"sharing is {sharing!r}: expected 'squeeze' or 'B', 'uniform' or 'A', or an array of weights")


def read_sharing_name(sharing: str) -> str:
    """Return the name of a sharing's weights, ``"squeeze"`` or ``"uniform"``, where an array would not do.

    Raises:
        ValueError: for a name that is none.
    """
    if not isinstance(sharing, str) or sharing not in SHARINGS:
        raise ValueError(f"sharing is {sharing!r}: expected 'squeeze' or 'B', 'uniform' or 'A'")
    return SHARINGS[sharing]


def named_weights(grasp: Grasp | ProblemBatch, sharing: str, numpy: Any) -> AnyArray:
    """Return the weights that ``"squeeze"`` or ``"uniform"`` stands for."""
    if sharing == "squeeze":
        return grasp.squeeze
    return numpy.ones(np.shape(grasp.points)[:-1], jnp.result_type(grasp.squeeze))


class FlatInput(NamedTuple):
    """Arrays with their leading axes broadcast and flattened into one."""

    problem: ProblemBatch
    per_problem: dict[str, Any]
    """Further arrays with one entry for each problem, by name."""
    batch: tuple[int, ...]
    """The leading axes."""


def flatten(
    grasp: Grasp,
    wrench: AnyArray,
    weights: AnyArray | None,
    sharing: str,
    *,
    free: AnyArray | None = None,
    limits: Limits | None = None,
    safety: float | AnyArray | None = None,
    per_problem: Mapping[str, tuple[Any, tuple[int, ...]]] = MappingProxyType({}),
    numpy: Any = jnp,
) -> FlatInput:
    """Flatten inputs of any leading axes into one batch in one precision.

    ``free`` are the twists that a guide allows, ``limits`` bound the forces and torques of the hand. Friction is
    divided by ``safety``. ``per_problem`` are further arrays with an entry for each problem, and their last axes;
    ``start`` becomes a field of the problem. The arrays are those of ``numpy``: ``jax.numpy``, or NumPy where nothing
    is to be compiled.
    """
    points, normals, friction, squeeze = grasp.points, grasp.normals, grasp.friction, grasp.squeeze
    n = _contacts(points)
    if sharing != "given":
        weights = named_weights(grasp, sharing, numpy)
    contacts = {"friction": friction, "squeeze": squeeze, "present": grasp.present, "sharing": weights}
    contacts["torsion"] = grasp.torsion
    fields: dict[str, tuple[AnyArray | None, tuple[int, ...]]]
    fields = {"points": (points, (n, 3)), "normals": (normals, (n, 3))}
    fields |= {name: (array, (n,)) for name, array in contacts.items()}
    if free is not None:
        fields["free"] = (free, (6, _directions(free)))
    fields |= _bounds(limits, n)
    fields |= {"wrench": (wrench, (6,)), **per_problem}
    optional = [array for array in (free, grasp.torsion, *jax.tree.leaves(limits)) if array is not None]
    dtype = _precision(
        points, normals, friction, squeeze, wrench, *(array for array, _ in per_problem.values()), *optional
    )
    arrays = {name: numpy.asarray(array, dtype) for name, (array, _) in fields.items() if array is not None}
    if safety is not None:
        arrays["friction"] = _safer(arrays["friction"], arrays.get("present"), safety, numpy)
    leading = {name: _leading_axes(name, array, fields[name][1]) for name, array in arrays.items()}
    batch = _broadcast(leading)
    # A grasp that all wrenches share stays one grasp: its own work is then done once.
    loads = ("wrench", *per_problem)
    shared = all(int(np.prod(axes)) == 1 for name, axes in leading.items() if name not in loads)
    flat = {}
    for name, array in arrays.items():
        tail = fields[name][1]
        if shared and name not in loads:
            flat[name] = array.reshape(1, *tail)
        else:
            flat[name] = numpy.broadcast_to(array, batch + tail).reshape(math.prod(batch), *tail)
    problem = ProblemBatch(
        points=flat["points"],
        normals=flat["normals"],
        friction=flat["friction"],
        squeeze=flat["squeeze"],
        present=flat.get("present"),
        weights=flat["sharing"],
        wrench=flat["wrench"],
        free=flat.get("free"),
        # A problem's own, as wrenches are, which the solver finds among the problem's fields.
        start=flat.get("start"),
        torsion=flat.get("torsion"),
        normal_min=flat.get("normal_min"),
        normal_max=flat.get("normal_max"),
        torque_bounds=TorqueBounds(flat["torque_map"], flat["torque_max"]) if "torque_map" in flat else None,
    )
    return FlatInput(problem, {name: flat[name] for name in per_problem if name != "start"}, batch)


def _safer(friction: AnyArray, present: AnyArray | None, safety: float | AnyArray, numpy: Any) -> AnyArray:
    """Divide finite friction by safety: dividing a NaN would make the derivative by safety NaN."""
    is_usable = numpy.isfinite(friction)
    if present is not None:
        is_usable = is_usable & (present > 0.5)
    divisor = numpy.asarray(safety, friction.dtype)[..., None]
    return numpy.where(is_usable, numpy.where(is_usable, friction, 0) / divisor, friction)


def refuse_soft_fingers(grasp: Grasp) -> None:
    """Raise where a grasp has torsional friction, for what knows hard fingers only."""
    if grasp.torsion is not None:
        raise ValueError("torsion is given: expected None, since this function supports hard fingers only")


def _contacts(points: AnyArray) -> int:
    shape = np.shape(points)
    if len(shape) < 2 or shape[-1] != 3 or shape[-2] == 0:
        raise ValueError(f"points has shape {shape}: expected (..., n, 3) with at least one contact")
    return shape[-2]


def _bounds(limits: Limits | None, n: int) -> dict[str, tuple[AnyArray | None, tuple[int, ...]]]:
    """Return the fields of limits and their last axes."""
    if limits is None:
        return {}
    if not isinstance(limits, Limits):
        raise TypeError(f"limits is of type {type(limits).__name__}: expected jaxgrasp.Limits")
    fields: dict[str, tuple[AnyArray | None, tuple[int, ...]]]
    fields = {"normal_min": (limits.normal_min, (n,)), "normal_max": (limits.normal_max, (n,))}
    torque_map, torque_max = limits.torque_map, limits.torque_max
    if (torque_map is None) != (torque_max is None):
        lacking = "torque_map" if torque_map is None else "torque_max"
        raise ValueError(f"{lacking} is None: expected torque_map and torque_max, or neither")
    if torque_map is None:
        return fields
    shape = np.shape(torque_map)
    if len(shape) < 3 or shape[-3] != n or shape[-2] not in (3, 4) or shape[-1] == 0:
        raise ValueError(f"torque_map has shape {shape}: expected (..., {n}, 3 or 4, joints)")
    return fields | {"torque_map": (torque_map, shape[-3:]), "torque_max": (torque_max, shape[-1:])}


def _directions(free: AnyArray) -> int:
    shape = np.shape(free)
    if len(shape) < 2 or shape[-2] != 6 or not 1 <= shape[-1] <= 6:
        raise ValueError(f"free has shape {shape}: expected (..., 6, k), a column for each of 1 to 6 twists")
    return shape[-1]


def _precision(*arrays: AnyArray) -> np.dtype:
    """Return the finest floating-point precision among the arrays, single at least.

    Integers and plain numbers do not count. Half precision has too few digits for the solver.
    """
    typed = (a if hasattr(a, "dtype") else jnp.asarray(a) for a in arrays)
    floats = [
        jax.dtypes.canonicalize_dtype(a.dtype)
        for a in typed
        if jnp.issubdtype(a.dtype, jnp.floating) and not getattr(a, "weak_type", False)
    ]
    finest = max(floats, key=lambda d: d.itemsize, default=jnp.asarray(0.0).dtype)
    return np.dtype(finest if finest.itemsize > 2 else np.float32)


def _broadcast(leading: dict[str, tuple[int, ...]]) -> tuple[int, ...]:
    try:
        return jnp.broadcast_shapes(*leading.values())
    except ValueError:
        shapes = ", ".join(f"{name} {axes}" for name, axes in leading.items() if axes)
        raise ValueError(f"leading axes do not broadcast against each other: {shapes}") from None


def _leading_axes(name: str, array: AnyArray, tail: tuple[int, ...]) -> tuple[int, ...]:
    if array.shape[max(array.ndim - len(tail), 0) :] != tail:
        raise ValueError(f"{name} has shape {array.shape}: expected (..., {', '.join(map(str, tail))})")
    return array.shape[: array.ndim - len(tail)]
