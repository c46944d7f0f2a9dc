"""What is wrong with concrete grasp data: found all at once, in NumPy, before anything is computed."""

import warnings
from collections.abc import Iterator
from dataclasses import dataclass

import jax
import numpy as np

from jaxgrasp.model.grasp import OPTIONAL, Grasp
from jaxgrasp.model.normal_direction import NAMED, direction_warning, normal_directions
from jaxgrasp.validation.values import check_instance

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
