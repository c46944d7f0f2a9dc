"""Input and result of the methods of the literature: arguments, checked and flattened, and answers."""

import math
from collections.abc import Iterator
from enum import IntEnum
from typing import NamedTuple

import equinox as eqx
import numpy as np

from jaxgrasp.model.arrays import AnyArray, Float, Int
from jaxgrasp.model.faults import Fault, GraspError, dtype_faults, entries, limit_faults, shape_faults, value_faults
from jaxgrasp.model.grasp import BOUNDS, Grasp, Limits


class MethodStatus(IntEnum):
    """Outcome of a problem by a method. The codes are stable in files.

    ``MethodStatus(int(answer.status)).advice`` is a sentence to act on.
    """

    advice: str

    SOLVED = 0, "These forces balance the wrench within the method's own constraints, and are best by its own measure."
    INFEASIBLE = (
        1,
        "No forces within the method's constraints give this wrench. Pyramids inside the cones, limits, or a demand to "
        "stay strictly inside the cones may be what forbids it: see whether constrained_optimum finds any.",
    )
    UNBOUNDED = (
        2,
        "The method's measure grows without end along internal forces: give limits that bound every normal force.",
    )
    NOT_CONVERGED = (
        3,
        "The method stopped before it reached an optimum or a proof that there is none: allow more steps, or rescale "
        "an extreme friction or limit.",
    )
    OUTSIDE_CONES = (
        4,
        "These forces balance the wrench, but a contact slips or pulls, and the method has no others to offer: "
        "use constrained_optimum.",
    )
    INVALID_DATA = 5, "The data hold entries that no method can use: run check_grasp on the grasp, look at the wrench."

    def __new__(cls, code: int, advice: str) -> "MethodStatus":
        member = int.__new__(cls, code)
        member._value_ = code
        member.advice = advice
        return member


class MethodAnswer(eqx.Module):
    """Contact forces by one method of the literature, for one problem or a batch, in float64."""

    forces: Float[AnyArray, "*batch n 3"]
    """Force of the hand on the object at each contact [N]; zero where the method found none."""
    status: Int[AnyArray, "*batch"]
    """Code of a [`jaxgrasp.literature.MethodStatus`][]."""
    objective: Float[AnyArray, "*batch"]
    """Value of the method's own measure, in its own unit, where SOLVED or OUTSIDE_CONES; else zero."""
    iterations: Int[AnyArray, "*batch"]
    """Iterations, in the method's own count: pivots of a simplex, changes of a working set, steps of a flow."""


class MethodInput(NamedTuple):
    """B problems of n contacts, float64; missing limits are infinite."""

    points: np.ndarray
    normals: np.ndarray
    friction: np.ndarray
    squeeze: np.ndarray
    present: np.ndarray
    """Booleans; a problem with invalid data has no present contact, and a wrench of zero."""
    wrench: np.ndarray
    normal_min: np.ndarray
    normal_max: np.ndarray
    torque_map: np.ndarray
    """``(B, n, 3, j)``, with j = 0 where there is none."""
    torque_max: np.ndarray
    valid: np.ndarray
    batch: tuple[int, ...]
    """Leading axes."""

    def answer(self, forces, status, objective, iterations) -> MethodAnswer:
        """Restore the leading axes of results of the flat batch ``(B, ...)``, and mark invalid problems."""
        status = np.where(self.valid, status, MethodStatus.INVALID_DATA).astype(int)
        has_forces = np.isin(status, (MethodStatus.SOLVED, MethodStatus.OUTSIDE_CONES))
        has_force = self.present[..., None] & has_forces[:, None, None]
        forces = np.where(has_force, forces, 0.0)
        objective = np.where(has_force.any((1, 2)), objective, 0.0)
        shaped = (np.asarray(x).reshape(self.batch + np.shape(x)[1:]) for x in (forces, status, objective, iterations))
        return MethodAnswer(*shaped)


def read_input(grasp: Grasp, wrench: AnyArray, limits: Limits | None = None, throw: bool = True) -> MethodInput:
    """Check the arguments, and flatten them to a batch of problems.

    Args:
        grasp: contacts ``(..., n)``, concrete; leading axes broadcast against the wrench's and the limits'.
        wrench: ``(..., 6)`` [N, N.m].
        limits: limits of normal forces and joint torques.
        throw: whether an invalid value raises; if not, its problem is marked as invalid. Shapes that do not fit raise.

    Raises:
        GraspError: for an invalid value, with the field, the first index, the value and the expected one.
        ValueError: for shapes that do not fit each other, and for soft fingers.
    """
    for issue in (*shape_faults(grasp), *dtype_faults(grasp)):
        raise GraspError(issue)
    _refuse_soft_fingers(grasp)
    fields = _fields(grasp, wrench, limits)
    batch = _leading(fields)
    fields = _unlimited_where_absent(fields)
    is_invalid = np.zeros(batch, bool)
    for issue in _value_faults(fields):
        if throw:
            raise GraspError(issue)
        lead = _lead(issue.field, fields[issue.field])
        marked = np.zeros(lead, bool)
        marked[issue.index[: len(lead)]] = True
        is_invalid |= marked
    flat, count = {}, math.prod(batch)
    for name, array in fields.items():
        tail = array.shape[len(_lead(name, array)) :]
        flat[name] = np.broadcast_to(array, batch + tail).reshape(count, *tail)
    return _harmless(flat, ~is_invalid.ravel(), batch)


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
"""Last axes of every field."""


def _refuse_soft_fingers(grasp: Grasp) -> None:
    if grasp.torsion is None:
        return
    torsion = np.asarray(grasp.torsion)
    for index in np.argwhere(torsion > 0):
        position = ", ".join(map(str, index))
        raise ValueError(
            f"torsion[{position}] is {torsion[tuple(index)]}: expected 0, since these methods are for hard contacts"
        )


def _fields(grasp: Grasp, wrench: AnyArray, limits: Limits | None) -> dict[str, np.ndarray]:
    """Convert every field to float64, and check its last axes."""
    n = np.shape(grasp.points)[-2]
    limits = Limits() if limits is None else limits
    mapped = np.zeros((n, 3, 0)) if limits.torque_map is None else np.asarray(limits.torque_map)
    sizes = {"n": n, "j": mapped.shape[-1] if mapped.ndim else 0}
    if limits.torque_max is not None and limits.torque_map is None:
        raise ValueError("torque_max is given without torque_map: expected both, since the map gives the torques")
    arrays = {
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
    fields = {name: np.asarray(array, float) for name, array in arrays.items()}
    for name, array in fields.items():
        tail = tuple(axis if isinstance(axis, int) else sizes[axis] for axis in TAILS[name])
        if array.ndim < len(tail) or array.shape[len(_lead(name, array)) :] != tail:
            raise ValueError(f"{name} has shape {array.shape}: expected (..., {', '.join(map(str, tail))})")
    return fields


def _lead(name: str, array: np.ndarray) -> tuple[int, ...]:
    """Return the leading axes of a field's own array."""
    return array.shape[: array.ndim - len(TAILS[name])]


def _leading(fields: dict[str, np.ndarray]) -> tuple[int, ...]:
    axes = {name: _lead(name, array) for name, array in fields.items()}
    try:
        return np.broadcast_shapes(*axes.values())
    except ValueError:
        text = ", ".join(f"{name} {shape}" for name, shape in axes.items() if shape)
        raise ValueError(f"leading axes do not broadcast against each other: {text}") from None


def _unlimited_where_absent(fields: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Remove the limits of absent contacts, and broadcast the two of normal forces to one shape."""
    is_present = fields["present"] == 1
    least = np.where(is_present, fields["normal_min"], 0)
    most = np.where(is_present, fields["normal_max"], np.inf)
    least, most = np.broadcast_arrays(least, most)
    torques = np.where(is_present[..., None, None], fields["torque_map"], 0)
    return fields | {"normal_min": least, "normal_max": most, "torque_map": torques}


def _value_faults(fields: dict[str, np.ndarray]) -> Iterator[Fault]:
    """List invalid entries of the grasp, then of the wrench, then of the limits of present contacts."""
    grasp = {name: fields[name] for name in ("points", "normals", "friction", "squeeze")}
    if fields["present"].ndim == grasp["friction"].ndim:
        yield from value_faults(**grasp, present=fields["present"])
    else:
        yield from value_faults(**grasp)
    yield from entries("wrench", fields["wrench"], ~np.isfinite(fields["wrench"]), "a finite number [N, N.m]")
    limits = {name: fields[name] for name in BOUNDS}
    # Limits of absent contacts were removed before.
    yield from limit_faults(limits, np.ones((), bool))


def _harmless(flat: dict[str, np.ndarray], valid: np.ndarray, batch: tuple[int, ...]) -> MethodInput:
    """Replace absent contacts and invalid data by values that cannot spread."""
    is_present = (flat.pop("present") > 0.5) & valid[:, None]
    for name, idle in (("points", 0), ("normals", 0), ("torque_map", 0), ("friction", 0), ("squeeze", 0)):
        array = flat[name]
        flat[name] = np.where(is_present.reshape(is_present.shape + (1,) * (array.ndim - 2)), array, idle)
    flat["normal_min"] = np.where(is_present, flat["normal_min"], 0)
    flat["normal_max"] = np.where(is_present, flat["normal_max"], np.inf)
    flat["torque_max"] = np.where(valid[:, None], flat["torque_max"], np.inf)
    flat["wrench"] = np.where(valid[:, None], flat["wrench"], 0)
    return MethodInput(present=is_present, valid=valid, batch=batch, **flat)
