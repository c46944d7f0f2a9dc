"""Concrete grasps of any leading axes as one flat batch on the host, after every entry was found usable.

Counts and ranges, as results show them in a line when they are printed.

Long batches, so many grasps at a time, with word of how far they have come.

Questions about wrench sets that NumPy answers, asked from inside ``jit``, ``vmap`` and ``grad``.

What is certified is host arithmetic in float64. A program on any device calls it back with all problems of a batch at
once; it is not differentiated: each measure adds its own derivative, by the envelope theorem.
"""

import math
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, core

from jaxgrasp.model.arguments import Progress, check_arguments
from jaxgrasp.model.faults import Fault, GraspError, check_entries, entries
from jaxgrasp.model.grasp import Grasp
from jaxgrasp.problem.wrench_discs import About, Ellipsoid, Length, WrenchDiscs, measured_discs
from jaxgrasp.quality.wrench_sets import WrenchSets


def count_of(masks: Mapping[str, np.ndarray | np.bool_]) -> str:
    """Format the count of true entries of each mask with its name, without masks that have none."""
    counts = {name: int(np.sum(mask)) for name, mask in masks.items()}
    return ", ".join(f"{count:,} {name}" for name, count in counts.items() if count) or "none"


def range_of(values: np.ndarray) -> str:
    """Format a single value as it is, and several values as their least, largest and median."""
    values = np.asarray(values, float)
    if not values.size:
        return "of nothing"
    if values.size == 1:
        return f"{float(values.reshape(())):.4g}"
    return f"{values.min():.4g} to {values.max():.4g}, median {np.median(values):.4g}"


TOGETHER = 256
"""Grasps that are looked at before the next: enough that the price of each operation does not count, where one takes
some milliseconds, and few enough that word comes often."""
MANY_TOGETHER = 1024
"""The same where a grasp takes some microseconds."""


def in_turn(
    count: int,
    question: Callable[[np.ndarray], tuple[np.ndarray, ...]],
    progress: Progress | None = None,
    together: int = TOGETHER,
) -> tuple[np.ndarray, ...]:
    """Call ``question`` on chunks of indices ``(g,)``; join its arrays ``(g, ...)`` into arrays ``(count, ...)``."""
    answers = []
    for start in range(0, max(count, 1), together):
        indices = np.arange(start, min(count, start + together))
        answers.append(question(indices))
        if progress is not None:
            progress(len(indices))
    return tuple(np.concatenate(parts) for parts in zip(*answers))


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


def is_traced(*arguments: object) -> bool:
    """Return True if an array among the arguments is traced, so that its values are unknown."""
    return any(isinstance(leaf, core.Tracer) for leaf in jax.tree.leaves(arguments))


def call_on_host(
    question: Callable[..., tuple[np.ndarray, ...]],
    trailing: tuple[tuple[int, ...], ...],
    grasp: Grasp,
    length: Length,
    about: About,
    ellipsoid: Ellipsoid = None,
    *,
    extra: tuple[Array, ...] = (),
    together: int = TOGETHER,
) -> tuple[WrenchDiscs, Any]:
    """Return the discs of traced grasps and the answers of ``question`` about them, which is called on the host.

    The answers are a tuple of JAX arrays, in the places where results have arrays of NumPy.

    Args:
        question: of wrench sets ``(G, ...)``, and the rows of ``extra``, the answers: arrays ``(G, *trailing)``.
        trailing: the shape of each answer behind the grasps' axes.
        grasp: contacts ``(..., n)``.
        length: see [`jaxgrasp.quality.ferrari_canny`][].
        about: likewise.
        ellipsoid: likewise.
        extra: further arrays with the grasps' axes ``(..., k)``.
        together: grasps that are looked at side by side.
    """
    check_arguments(grasp, {}, {"length": (length, ()), "about": (about, (3,)), "ellipsoid": (ellipsoid, (6, 6))})
    shapes, growth = measured_discs(grasp, length, about, ellipsoid)
    dtype, batch = shapes.centres.dtype, shapes.length.shape
    is_present = jnp.ones(grasp.friction.shape, bool) if grasp.present is None else jnp.asarray(grasp.present) > 0.5
    reach = jnp.max(jnp.where(is_present[..., None], jnp.abs(jnp.asarray(grasp.points)), 0), (-1, -2), initial=0)
    operands = (shapes.centres, shapes.spans, is_present, growth * (1 + reach / shapes.length), *extra)
    precision = float(jnp.finfo(dtype).eps)

    def answer(centres: Array, spans: Array, present: Array, spread: Array, *extra: Array) -> tuple[np.ndarray, ...]:
        axes = np.shape(spread)
        rounding = (ROUNDING * precision * np.asarray(spread, np.float64)).reshape(-1)
        bodies = WrenchSets.of_discs(np.asarray(centres), np.asarray(spans), np.asarray(present), rounding)
        rows = [np.asarray(array, np.float64).reshape(-1, np.shape(array)[-1]) for array in extra]
        answers = in_turn(
            len(rounding),
            lambda indices: question(bodies.take(indices), *(array[indices] for array in rows)),
            together=together,
        )
        return tuple(np.asarray(array, dtype).reshape((*axes, *shape)) for array, shape in zip(answers, trailing))

    result_shapes = tuple(jax.ShapeDtypeStruct((*batch, *shape), dtype) for shape in trailing)
    return shapes, jax.pure_callback(
        answer, result_shapes, *jax.lax.stop_gradient(operands), vmap_method="broadcast_all"
    )


def with_derivative_of(value: Any, differentiable: Array) -> Any:
    """Return ``value`` with the derivative of ``differentiable``."""
    return value + (differentiable - jax.lax.stop_gradient(differentiable))
