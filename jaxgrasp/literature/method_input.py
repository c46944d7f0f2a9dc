"""What users pass, checked and laid out as a flat batch in float64; and the way back to their leading axes."""

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from jaxgrasp.literature.method_answer import MethodAnswer, MethodStatus
from jaxgrasp.model.arrays import AnyArray
from jaxgrasp.model.faults import Fault, GraspError, dtype_faults, entries, shape_faults, value_faults
from jaxgrasp.model.grasp import Grasp
from jaxgrasp.model.limit_faults import limit_faults
from jaxgrasp.model.limits import BOUNDS, Limits


class MethodInput(NamedTuple):
    """B problems of n contacts, float64; limits that were not given do not limit."""

    points: np.ndarray
    normals: np.ndarray
    friction: np.ndarray
    squeeze: np.ndarray
    present: np.ndarray
    """Booleans; of a problem whose data are invalid no contact is present, and its wrench is zero."""
    wrench: np.ndarray
    normal_min: np.ndarray
    normal_max: np.ndarray
    torque_map: np.ndarray
    """``(B, n, 3, j)``, j = 0 where there is none."""
    torque_max: np.ndarray
    valid: np.ndarray
    batch: tuple[int, ...]
    """The leading axes."""

    def answer(self, forces, status, objective, iterations) -> MethodAnswer:
        """Results of the flat batch ``(B, ...)`` with the leading axes restored and invalid problems marked."""
        status = np.where(self.valid, status, MethodStatus.INVALID_DATA).astype(int)
        has_forces = np.isin(status, (MethodStatus.SOLVED, MethodStatus.OUTSIDE_CONES))
        there = self.present[..., None] & has_forces[:, None, None]
        forces = np.where(there, forces, 0.0)
        objective = np.where(there.any((1, 2)), objective, 0.0)
        shaped = (np.asarray(x).reshape(self.batch + np.shape(x)[1:]) for x in (forces, status, objective, iterations))
        return MethodAnswer(*shaped)


def read_input(grasp: Grasp, wrench: AnyArray, limits: Limits | None = None, throw: bool = True) -> MethodInput:
    """Problems as a flat batch, checked before anything is computed.

    Args:
        grasp: contacts ``(..., n)``, concrete; leading axes broadcast against the wrench's and the limits'.
        wrench: ``(..., 6)`` [N, N.m].
        limits: of normal forces and joint torques.
        throw: whether a bad value raises; if not, its problem is marked as invalid. Shapes that do not fit raise.

    Raises:
        GraspError: naming the field, the first bad index, the value and what was expected.
        ValueError: for shapes that do not fit each other, and for soft fingers.
    """
    for fault in (*shape_faults(grasp), *dtype_faults(grasp)):
        raise GraspError(fault)
    _refuse_soft_fingers(grasp)
    fields = _fields(grasp, wrench, limits)
    batch = _leading(fields)
    fields = _unlimited_where_absent(fields)
    bad = np.zeros(batch, bool)
    for fault in _value_faults(fields):
        if throw:
            raise GraspError(fault)
        lead = _lead(fault.field, fields[fault.field])
        marked = np.zeros(lead, bool)
        marked[fault.index[: len(lead)]] = True
        bad |= marked
    flat, count = {}, math.prod(batch)
    for name, array in fields.items():
        tail = array.shape[len(_lead(name, array)) :]
        flat[name] = np.broadcast_to(array, batch + tail).reshape(count, *tail)
    return _harmless(flat, ~bad.ravel(), batch)


TAILS: dict[str, tuple[str | int, ...]] = {
    "points": ("n", 3),
    "normals": ("n", 3),
    "friction": ("n",),
    "squeeze": ("n",),
    "present": ("n",),
    "wrench": (6,),
    "normal_min": ("n",),
    "normal_max": ("n",),
    "torque_map": ("n", 3, "j"),
    "torque_max": ("j",),
}
"""The last axes of every field."""


def _refuse_soft_fingers(grasp: Grasp) -> None:
    if grasp.torsion is None:
        return
    torsion = np.asarray(grasp.torsion)
    for index in np.argwhere(torsion > 0):
        place = ", ".join(map(str, index))
        raise ValueError(
            f"torsion[{place}] is {torsion[tuple(index)]}: expected 0, since these methods know hard contacts only"
        )


def _fields(grasp: Grasp, wrench: AnyArray, limits: Limits | None) -> dict[str, np.ndarray]:
    """Every field as float64 with the right last axes."""
    n = np.shape(grasp.points)[-2]
    limits = Limits() if limits is None else limits
    mapped = np.zeros((n, 3, 0)) if limits.torque_map is None else np.asarray(limits.torque_map)
    sizes = {"n": n, "j": mapped.shape[-1] if mapped.ndim else 0}
    if limits.torque_max is not None and limits.torque_map is None:
        raise ValueError("torque_max is given without torque_map: torques are known by the map alone")
    given = {
        "points": grasp.points,
        "normals": grasp.normals,
        "friction": grasp.friction,
        "squeeze": grasp.squeeze,
        "present": np.ones(n) if grasp.present is None else grasp.present,
        "wrench": wrench,
        "normal_min": np.zeros(n) if limits.normal_min is None else limits.normal_min,
        "normal_max": np.full(n, np.inf) if limits.normal_max is None else limits.normal_max,
        "torque_map": mapped,
        "torque_max": np.full(sizes["j"], np.inf) if limits.torque_max is None else limits.torque_max,
    }
    fields = {name: np.asarray(array, float) for name, array in given.items()}
    for name, array in fields.items():
        tail = tuple(axis if isinstance(axis, int) else sizes[axis] for axis in TAILS[name])
        if array.ndim < len(tail) or array.shape[len(_lead(name, array)) :] != tail:
            raise ValueError(f"{name} has shape {array.shape}: expected (..., {', '.join(map(str, tail))})")
    return fields


def _lead(name: str, array: np.ndarray) -> tuple[int, ...]:
    """The leading axes of a field's own array."""
    return array.shape[: array.ndim - len(TAILS[name])]


def _leading(fields: dict[str, np.ndarray]) -> tuple[int, ...]:
    axes = {name: _lead(name, array) for name, array in fields.items()}
    try:
        return np.broadcast_shapes(*axes.values())
    except ValueError:
        said = ", ".join(f"{name} {shape}" for name, shape in axes.items() if shape)
        raise ValueError(f"leading axes do not broadcast against each other: {said}") from None


def _unlimited_where_absent(fields: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Limits of absent contacts are not looked at; the two of normal forces get one shape."""
    there = fields["present"] == 1
    least = np.where(there, fields["normal_min"], 0)
    most = np.where(there, fields["normal_max"], np.inf)
    least, most = np.broadcast_arrays(least, most)
    torques = np.where(there[..., None, None], fields["torque_map"], 0)
    return fields | {"normal_min": least, "normal_max": most, "torque_map": torques}


def _value_faults(fields: dict[str, np.ndarray]) -> Iterator[Fault]:
    """Bad entries of the grasp, then of the wrench, then of the limits of contacts that are present."""
    grasp = {name: fields[name] for name in ("points", "normals", "friction", "squeeze")}
    if fields["present"].ndim == grasp["friction"].ndim:
        yield from value_faults(**grasp, present=fields["present"])
    else:
        yield from value_faults(**grasp)
    yield from entries("wrench", fields["wrench"], ~np.isfinite(fields["wrench"]), "a finite number [N, N.m]")
    limits = {name: fields[name] for name in BOUNDS}
    # Those of absent contacts are none by now.
    yield from limit_faults(limits, np.ones((), bool))


def _harmless(flat: dict[str, np.ndarray], valid: np.ndarray, batch: tuple[int, ...]) -> MethodInput:
    """Problems whose absent contacts and invalid data hold nothing that could spread."""
    there = (flat.pop("present") > 0.5) & valid[:, None]
    for name, idle in (("points", 0), ("normals", 0), ("torque_map", 0), ("friction", 0), ("squeeze", 0)):
        array = flat[name]
        flat[name] = np.where(there.reshape(there.shape + (1,) * (array.ndim - 2)), array, idle)
    flat["normal_min"] = np.where(there, flat["normal_min"], 0)
    flat["normal_max"] = np.where(there, flat["normal_max"], np.inf)
    flat["torque_max"] = np.where(valid[:, None], flat["torque_max"], np.inf)
    flat["wrench"] = np.where(valid[:, None], flat["wrench"], 0)
    return MethodInput(present=there, valid=valid, batch=batch, **flat)
