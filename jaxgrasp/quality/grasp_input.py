"""Concrete grasps of any leading axes as one flat batch on the host, after every entry was found usable."""

import math
from typing import NamedTuple

import jax
import numpy as np

from jaxgrasp.model.faults import Fault, GraspError, check_entries, entries
from jaxgrasp.model.grasp import Grasp
from jaxgrasp.problem.wrench_discs import About, Ellipsoid, Length, WrenchDiscs, measured_discs
from jaxgrasp.quality.wrench_sets import WrenchSets

ROUNDING = 32.0
"""Rounding of the products and sums behind a support, in units in the last place."""
FLAT = 1e-6
"""An ellipsoid whose shortest axis is no longer than rounding over this, relative to its longest, is flat."""


class GraspInput(NamedTuple):
    """A batch of grasps as discs in float64."""

    shapes: WrenchDiscs
    """Discs of wrenches of the contacts, as NumPy arrays."""
    present: np.ndarray
    """``(..., n)`` of truth."""
    rounding: np.ndarray
    """``(...)``, relative: the data's own, which a frame far away makes larger."""
    soft: bool
    """True if any finger is soft."""

    @property
    def batch(self) -> tuple[int, ...]:
        return self.present.shape[:-1]

    def bodies(self) -> WrenchSets:
        """Return the set of wrenches that the contacts of each grasp reach, in one flat batch."""
        centres, spans = np.asarray(self.shapes.centres), np.asarray(self.shapes.spans)
        return WrenchSets.of_discs(centres, spans, self.present, np.asarray(self.rounding))


def read_grasps(grasp: Grasp, length: Length = None, about: About = None, ellipsoid: Ellipsoid = None) -> GraspInput:
    """Check grasps and compute their discs in float64, whatever JAX's mode and the precision of the data.

    Raises:
        GraspError: for the first entry that is not usable, as ``check_entries``, of the other arguments too.
        TypeError: for traced arrays, as under ``jit``.
    """
    check_entries(grasp)
    unit, middle, axes = _check_frame(grasp, length, about, ellipsoid)
    precision = np.finfo(np.asarray(grasp.points).dtype).eps
    with jax.enable_x64(True):
        in_float64 = jax.tree.map(lambda array: np.asarray(array, np.float64), grasp)
        shapes, growth = jax.tree.map(np.asarray, _discs(in_float64, unit, middle, axes))
    present = (
        np.ones(in_float64.friction.shape, bool) if grasp.present is None else np.asarray(in_float64.present) > 0.5
    )
    reach = np.max(np.where(present[..., None], np.abs(in_float64.points), 0), (-1, -2), initial=0)
    soft = in_float64.torsion is not None and bool(np.any(np.where(present, in_float64.torsion, 0) > 0))
    return GraspInput(shapes, present, ROUNDING * precision * growth * (1 + reach / shapes.length), soft)


_discs = jax.jit(measured_discs)


def _check_frame(
    grasp: Grasp, length: Length, about: About, ellipsoid: Ellipsoid
) -> tuple[np.ndarray | None, np.ndarray | None, np.ndarray | None]:
    """Check the length, the point and the ellipsoid, and broadcast them to the grasps' leading axes."""
    batch = np.shape(grasp.points)[:-2]
    arguments = {"length": (length, batch), "about": (about, (*batch, 3)), "ellipsoid": (ellipsoid, (*batch, 6, 6))}
    arrays: dict[str, np.ndarray | None] = {}
    for name, (value, shape) in arguments.items():
        if value is None:
            arrays[name] = None
            continue
        array = np.asarray(value, np.float64)
        try:
            arrays[name] = np.broadcast_to(array, shape)
        except ValueError:
            expected = f"a shape that broadcasts to {shape}, as points imply"
            raise GraspError(Fault(name, (), f"an array of shape {array.shape}", expected)) from None
        bad = ~((array > 0) & np.isfinite(array)) if name == "length" else ~np.isfinite(array)
        for fault in entries(name, array, bad, _EXPECTED[name]):
            raise GraspError(fault)
    if ellipsoid is not None:
        axes = np.asarray(ellipsoid, np.float64)
        flat = np.linalg.cond(axes) * np.finfo(np.float64).eps >= FLAT
        for index in np.argwhere(flat):
            position = tuple(map(int, index))
            raise GraspError(Fault("ellipsoid", position, "flat", "six semi-axes that span all wrenches"))
    return arrays["length"], arrays["about"], arrays["ellipsoid"]


_EXPECTED = {
    "length": "a finite length above zero [m]",
    "about": "a finite coordinate [m]",
    "ellipsoid": "a finite number [N, N.m]",
}


def check_tolerance(tol: float) -> None:
    if not (math.isfinite(tol) and 0 < tol < 1):
        raise ValueError(f"tol is {tol}: expected a number between 0 and 1")
