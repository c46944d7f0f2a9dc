"""What is wrong with concrete grasp data: found all at once, in NumPy, before anything is computed.

Which grasps have normals that point out of the object, as far as contacts alone can tell; NumPy on flat arrays.

What is wrong with concrete limits, before anything is computed.
"""

import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import jax
import numpy as np

from jaxgrasp.files.printable import shortened
from jaxgrasp.model.grasp import BOUNDS, NORMALS, OPTIONAL, TORQUES, Grasp, Limits
from jaxgrasp.validation.checked import check_instance

ROUNDING = 1e-3
"""Part of the distances: as far as normals out of files may be off."""
STRAIGHT_AWAY = -np.sqrt(0.5)
"""Cosine of normal and direction to the middle: a contact beyond 135 degrees is suspected by itself."""
NAMED = 5
"""Grasps that a warning names."""


class NormalDirections(NamedTuple):
    """Sign of the normals of each of N grasps, as far as their contacts tell."""

    away: np.ndarray
    """``(N,)``: normals point away from the middle of the grasp's contacts, in all or straight at a contact."""
    decided: np.ndarray
    """``(N,)``: False where normals lie across the directions to the middle, so that contacts cannot tell."""


def normal_directions(points: np.ndarray, normals: np.ndarray, offsets: np.ndarray) -> NormalDirections:
    """Return which grasps have normals that point away from the middle of their contacts.

    Inward normals of a convex object never do: the middle q of points p on it lies inside, so that a . (q - p) >= 0.

    Args:
        points: contacts of all grasps ``(M, 3)`` [m].
        normals: ``(M, 3)``.
        offsets: grasp i owns contacts ``offsets[i]:offsets[i + 1]``, ``(N + 1,)``.
    """
    sizes = np.diff(offsets)
    away, decided = np.zeros(len(sizes), bool), np.zeros(len(sizes), bool)
    held = np.flatnonzero(sizes)
    if not len(held):
        return NormalDirections(away, decided)
    starts, owner = offsets[:-1][held], np.repeat(np.arange(len(held)), sizes[held])
    with np.errstate(invalid="ignore", over="ignore"):
        ways = to_middle(points, offsets)
        distance, inward = np.linalg.norm(ways, axis=1), np.einsum("ci,ci->c", ways, normals)
        reach, total = np.add.reduceat(distance, starts), np.add.reduceat(inward, starts)
        straight = (distance > ROUNDING * reach[owner]) & (inward < STRAIGHT_AWAY * distance)
        away[held] = (total < -ROUNDING * reach) | np.logical_or.reduceat(straight, starts)
        decided[held] = away[held] | (total > ROUNDING * reach)
    return NormalDirections(away, decided)


def to_middle(points: np.ndarray, offsets: np.ndarray) -> np.ndarray:
    """Return the vectors from each contact to the mean of its grasp's contacts, ``(M, 3)`` [m]."""
    held = np.flatnonzero(np.diff(offsets))
    if not len(held):
        return np.zeros((0, 3))
    sizes = np.diff(offsets)[held]
    middle = np.add.reduceat(points, offsets[:-1][held], axis=0) / sizes[:, None]
    return np.repeat(middle, sizes, axis=0) - points


def direction_warning(names: Sequence[str], away: int, decided: int, remedy: str) -> str:
    """Return the sentence that warns of grasps whose normals point away, of which there are ``away``.

    Args:
        names: of the first such grasps.
        away: how many there are.
        decided: of how many grasps the contacts can tell.
        remedy: how the sentence ends, after the grasps that are to be checked.
    """
    shown = ", ".join(shortened(name) for name in names[:NAMED]) + (", ..." if away > len(names[:NAMED]) else "")
    return (
        f"normals of {away:,} of {decided:,} grasps point away from the middle of their contacts, as those into a "
        f"convex object never do ({shown}): {remedy}"
    )


UNIT_TOLERANCE = 1e-6
UNIT_LENGTH = "a vector of length 1 (to 1e-6)"


@dataclass(frozen=True)
class Fault:
    """A bad entry: its field, index and value, and the value that was expected."""

    field: str
    index: tuple[int, ...]
    value: object
    expected: str
    place: str = ""
    """Line of a file and name of the grasp, where the data have any."""

    def __str__(self) -> str:
        index = f"[{', '.join(map(str, self.index))}]" if self.index else ""
        place = f"{self.place}: " if self.place else ""
        return f"{place}{self.field}{index} is {self.value}: expected {self.expected}"


class GraspError(ValueError):
    """Concrete grasp data that cannot be used. ``fault`` says which entry."""

    def __init__(self, fault: Fault):
        super().__init__(str(fault))
        self.fault = fault


def check_grasp(grasp: Grasp) -> Grasp:
    """Raise unless the concrete ``grasp`` is usable, and return it unchanged; warn of normals that point outward.

    Checked, in this order: shapes, dtypes, finite values, unit normals (to 1e-6), friction, squeeze and torsion
    not negative, no torsion without friction. Entries of absent contacts are not looked at, since no method reads them.

    Example:
        >>> from jaxgrasp import Grasp, check_grasp
        >>> check_grasp(Grasp([[0, 0, 0.1]], [[0, 0, -1.0]], [-0.5], [1.0]))
        Traceback (most recent call last):
          ...
        jaxgrasp.model.faults.GraspError: friction[0] is -0.5: expected a finite number, zero or more

    Raises:
        GraspError: naming the field, the first bad index, the value and what was expected.
        TypeError: if the grasp is traced, as under ``jit``: there are no values to check.

    Warns:
        UserWarning: naming the grasps of the batch whose normals point away from the middle of their contacts, as
            normals into a convex object never do.
    """
    check_entries(grasp)
    _warn_of_outward(grasp)
    return grasp


def check_entries(grasp: Grasp) -> None:
    """Raise unless the concrete ``grasp`` is usable, as [`jaxgrasp.check_grasp`][] does, without its warning."""
    check_instance("grasp", grasp, Grasp)
    if any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(grasp)):
        raise TypeError("check_grasp needs concrete arrays: call it outside jit, vmap and grad")
    for fault in (*shape_faults(grasp), *dtype_faults(grasp)):
        raise GraspError(fault)
    fields = {name: np.asarray(getattr(grasp, name)) for name in ("points", "normals", "friction", "squeeze")}
    fields |= {name: np.asarray(array) for name in OPTIONAL if (array := getattr(grasp, name)) is not None}
    for fault in value_faults(**fields):
        raise GraspError(fault)


def _warn_of_outward(grasp: Grasp) -> None:
    points, normals = np.asarray(grasp.points), np.asarray(grasp.normals)
    batch, n = points.shape[:-2], points.shape[-2]
    present = np.ones((*batch, n), bool) if grasp.present is None else np.asarray(grasp.present) > 0.5
    sizes = present.reshape(-1, n).sum(1)
    offsets = np.concatenate([[0], np.cumsum(sizes)])
    away, decided = normal_directions(points[present], normals[present], offsets)
    if not away.any():
        return
    remedy = "expected normals into the object"
    if batch:
        names = [str([int(i) for i in np.unravel_index(k, batch)]) for k in np.flatnonzero(away)[:NAMED]]
        warning = direction_warning(names, int(away.sum()), int(decided.sum()), remedy)
    else:
        warning = f"normals point away from the middle of the contacts, as no convex object's do: {remedy}"
    warnings.warn(warning, stacklevel=3)


def shape_faults(grasp: Grasp) -> Iterator[Fault]:
    """Fields of a Grasp whose shape does not fit ``points``."""
    shape = np.shape(grasp.points)
    if len(shape) < 2 or shape[-1] != 3:
        yield Fault("points", (), f"an array of shape {shape}", "a shape (..., n, 3)")
        return
    shapes = {"normals": shape, "friction": shape[:-1], "squeeze": shape[:-1]} | dict.fromkeys(OPTIONAL, shape[:-1])
    for name, expected in shapes.items():
        array = getattr(grasp, name)
        if not (name in OPTIONAL and array is None) and np.shape(array) != expected:
            yield Fault(name, (), f"an array of shape {np.shape(array)}", f"the shape {expected} that points imply")


def dtype_faults(grasp: Grasp) -> Iterator[Fault]:
    """Fields of a Grasp that hold no floating-point numbers, or of another precision than ``points``."""
    dtype = np.asarray(grasp.points).dtype
    for name in ("points", "normals", "friction", "squeeze", *OPTIONAL):
        array = getattr(grasp, name)
        if array is None:
            continue
        if not np.issubdtype(np.asarray(array).dtype, np.floating):
            yield Fault(name, (), f"an array of {np.asarray(array).dtype}", "floating-point numbers")
        elif np.asarray(array).dtype != dtype:
            yield Fault(name, (), f"an array of {np.asarray(array).dtype}", f"the dtype {dtype} of points")


def value_faults(
    points: np.ndarray,
    normals: np.ndarray,
    friction: np.ndarray,
    squeeze: np.ndarray,
    present: np.ndarray | None = None,
    torsion: np.ndarray | None = None,
) -> Iterator[Fault]:
    """Every entry that breaks a rule, field by field; shapes must fit already."""
    if present is not None:
        yield from entries("present", present, (present != 0) & (present != 1), "0 or 1")
        looked_at = present == 1
    else:
        looked_at = np.ones(friction.shape, bool)
    finite_normals = np.isfinite(normals).all(-1)
    yield from entries("points", points, looked_at & ~np.isfinite(points).all(-1), "finite coordinates [m]")
    yield from entries("normals", normals, looked_at & ~finite_normals, "finite components")
    with np.errstate(invalid="ignore", over="ignore"):
        length = np.sqrt(np.einsum("...i,...i->...", normals, normals))
        # A float32 file keeps unit length to about 1e-7, so one tolerance serves both precisions.
        not_unit = looked_at & finite_normals & (np.abs(length - 1) > UNIT_TOLERANCE)
        yield from entries("normals", normals, not_unit, UNIT_LENGTH, length)
        for name, values in (("friction", friction), ("squeeze", squeeze)):
            bad = looked_at & ~(np.isfinite(values) & (values >= 0))
            yield from entries(name, values, bad, "a finite number, zero or more")
            least = np.finfo(values.dtype).tiny
            vanishing = looked_at & (values > 0) & (values < least)
            yield from entries(name, values, vanishing, f"0, or at least {least:.3g}: less may count as 0")
        if torsion is not None:
            bad = ~(np.isfinite(torsion) & (torsion >= 0))
            yield from entries("torsion", torsion, looked_at & bad, "a finite length [m], zero or more")
            slick = (friction == 0) & (torsion > 0)
            yield from entries("torsion", torsion, looked_at & slick, "0 where friction is 0")


def entries(
    field: str, values: np.ndarray, bad: np.ndarray | np.bool_, expected: str, length: np.ndarray | None = None
) -> Iterator[Fault]:
    """Return the bad entries of a field, in order; a field may be a single number."""
    for index in np.argwhere(bad):
        position = tuple(int(i) for i in index)
        value = values[position]
        shown = np.array2string(value, precision=6) if value.ndim else repr(value.item())
        if length is not None:
            shown += f", of length {length[position]:.9g}"
        yield Fault(field, position, shown, expected)


def check_limits(limits: Limits, grasp: Grasp) -> Limits:
    """Raise unless the concrete ``limits`` fit the ``grasp`` and are usable, and return them unchanged.

    Checked, in this order: shapes, then numbers: none is NaN, bounds are zero or more, the largest normal force is no
    smaller than the least, and only upper bounds are infinite. Entries of absent contacts are not looked at.

    Raises:
        GraspError: naming the field, the first bad index, the value and what was expected.
        TypeError: if anything is traced, as under ``jit``: there are no values to check.
    """
    check_instance("limits", limits, Limits)
    check_instance("grasp", grasp, Grasp)
    if any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves((limits, grasp))):
        raise TypeError("check_limits needs concrete arrays: call it outside jit, vmap and grad")
    arrays = {name: getattr(limits, name) for name in BOUNDS}
    arrays = {name: np.asarray(array) for name, array in arrays.items() if array is not None}
    _check_shapes(arrays, np.shape(grasp.points))
    present = np.ones(np.shape(grasp.friction), bool) if grasp.present is None else np.asarray(grasp.present) == 1
    for fault in limit_faults(arrays, present):
        raise GraspError(fault)
    return limits


def _check_shapes(arrays: dict[str, np.ndarray], points: tuple[int, ...]) -> None:
    for name in NORMALS:
        if name in arrays and arrays[name].shape != points[:-1]:
            expected = f"the shape {points[:-1]} that points imply"
            raise GraspError(Fault(name, (), f"an array of shape {arrays[name].shape}", expected))
    if not any(name in arrays for name in TORQUES):
        return
    for name in TORQUES:
        if name not in arrays:
            counterpart = TORQUES[1 - TORQUES.index(name)]
            raise GraspError(Fault(name, (), "None", f"an array, beside {counterpart}"))
    shape, batch = arrays["torque_map"].shape, points[:-1]
    if len(shape) != len(batch) + 2 or shape[:-2] != batch or shape[-2] not in (3, 4) or shape[-1] == 0:
        expected = f"a shape ({', '.join(map(str, batch))}, 3 or 4, joints)"
        raise GraspError(Fault("torque_map", (), f"an array of shape {shape}", expected))
    bounds_shape = (*batch[:-1], shape[-1])
    if arrays["torque_max"].shape != bounds_shape:
        description = f"an array of shape {arrays['torque_max'].shape}"
        raise GraspError(Fault("torque_max", (), description, f"the shape {bounds_shape} that torque_map implies"))


def limit_faults(arrays: Mapping[str, np.ndarray], present: np.ndarray) -> Iterator[Fault]:
    """Every entry of some of the fields of Limits that breaks a rule; shapes must fit already."""
    finite = "a finite number, zero or more"
    for name, array in arrays.items():
        looked_at = {"torque_max": True, "torque_map": present[..., None, None]}.get(name, present)
        endless = name.endswith("_max")
        with np.errstate(invalid="ignore"):
            is_usable = np.isfinite(array) if name == "torque_map" else (array >= 0) & (endless | np.isfinite(array))
        expected = "a finite number" if name == "torque_map" else "a number, zero or more" if endless else finite
        yield from entries(name, array, looked_at & ~is_usable, expected)
    if all(name in arrays for name in NORMALS):
        low, high = (arrays[name] for name in NORMALS)
        for index in np.argwhere(present & (high < low)):
            position = tuple(int(i) for i in index)
            expected = f"no less than normal_min there, {low[position].item()!r}"
            yield Fault("normal_max", position, repr(high[position].item()), expected)
