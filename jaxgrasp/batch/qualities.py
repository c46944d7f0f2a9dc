"""Measures of contact sets beside their forces: quality, price of friction, squeeze factor, friction margins.

Friction margins come by a single program for the contacts of all grasps, so that all batches agree: a program for each
shape of a batch would round in a way of its own.
"""

from dataclasses import dataclass, replace
from functools import cache, partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxgrasp.batch.chunk_statistics import LogHistogram
from jaxgrasp.batch.contact_sets import ContactSets
from jaxgrasp.batch.engine import widened
from jaxgrasp.force.least_friction import least_friction
from jaxgrasp.force.slip import friction_margin, spin_force
from jaxgrasp.model.arguments import Progress
from jaxgrasp.model.arrays import Float
from jaxgrasp.model.grasp import Grasp
from jaxgrasp.model.solution import Solution, Verdict, is_held, is_optimum
from jaxgrasp.numerics import vec3
from jaxgrasp.numerics.compiled_code import jit_here
from jaxgrasp.quality.ferrari_canny import TOLERANCE
from jaxgrasp.quality.grasp_input import TOGETHER
from jaxgrasp.quality.measures import UNDECIDED, Columns, Measure, MeasuredGrasps
from jaxgrasp.validation.checked import checked


@checked
def price_of_friction(closed: Solution, optimum: Solution) -> Float[np.ndarray, "*batch"]:
    """Compute the share (F* - F) / F* of the optimum's objective that the closed form leaves out by ignoring friction.

    Args:
        closed: answers of [`jaxgrasp.closed_form`][].
        optimum: answers of [`jaxgrasp.constrained_optimum`][] to the same problems, by the same sharing.

    Returns:
        Shares ``(*batch)``, 0 to 1: 0 where the closed form is the optimum, NaN where there is no optimum.

    Raises:
        ValueError: where ``optimum`` holds a verdict of closed forms, or the leading axes do not broadcast.

    Example:
        >>> import jaxgrasp, numpy as np
        >>> grasp = jaxgrasp.Grasp([[0, 0, -1], [0, 0, 1]], [[0, 0, 1], [0, 0, -1]], [0.5, 0.5], [1, 1])
        >>> closed, optimum = jaxgrasp.closed_form_and_optimum(grasp, np.array([1.5, 0, 0, 0, 0, 0]))
        >>> round(float(jaxgrasp.price_of_friction(closed, optimum)), 3)
        0.308
    """
    verdict = np.asarray(optimum.verdict)
    if np.any(verdict == Verdict.OUTSIDE_CONES):
        index = tuple(int(k) for k in np.argwhere(verdict == Verdict.OUTSIDE_CONES)[0])
        raise ValueError(
            f"optimum.verdict{list(index) or ''} is OUTSIDE_CONES: expected answers of constrained_optimum"
        )
    share = objective_gap(np.asarray(closed.objective), np.asarray(optimum.objective), verdict)
    # Rounding leaves objectives that are all but equal in either order.
    return np.where(is_optimum(verdict), np.maximum(share, 0), np.nan)


def objective_gap(closed: Any, optimum: Any, verdict: Any) -> np.ndarray:
    """Return (F* - F) / F*, by the objectives F of a closed form and F* of its optimum, whose verdict is given.

    Zero where the closed form is the optimum; the value has no meaning where there is no optimum.
    """
    already = verdict == Verdict.CLOSED_FORM_OPTIMAL
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(already, 0, (optimum - closed) / optimum)


LITTLE = 2.0**-20
"""Factor that makes squeezing forces nearly zero."""


def total_squeeze(sets: ContactSets) -> np.ndarray:
    """Return the sum of squeezing forces of each grasp ``(N, 1)`` [N]."""
    return np.add.reduceat(sets.squeeze.astype(float), sets.offsets[:-1])[:, None]


def normal_force_ratio(sets: ContactSets, forces: np.ndarray, verdict: np.ndarray, squeezed: np.ndarray) -> np.ndarray:
    """Return the sum of normal forces over a sum of squeezing forces ``(N, W)``.

    Args:
        sets: the grasps.
        forces: ``(M, W, 3)`` [N], by one method.
        verdict: ``(N, W)``.
        squeezed: the sum to compare with ``(N, 1)`` [N].

    Returns:
        NaN where the forces do not hold, and where the hand squeezes with nothing.
    """
    # Ratio sum_i n_i.f_i / sum_i s_i of each grasp and wrench.
    pressed = np.einsum("cwi,ci->cw", forces.astype(float), sets.normals.astype(float))
    total = np.add.reduceat(pressed, sets.offsets[:-1], axis=0)
    return np.divide(total, squeezed, out=np.full(total.shape, np.nan), where=is_held(verdict) & (squeezed > 0))


def clip_to_one(sets: ContactSets, factor: np.ndarray) -> np.ndarray:
    """Return factors with 1 in place of all that are no larger, to the root of the rounding."""
    return np.where(factor <= 1 + float(np.finfo(sets.points.dtype).eps) ** 0.5, 1, factor)


def with_little_squeeze(sets: ContactSets, chosen: np.ndarray) -> ContactSets:
    """Return grasps that hardly squeeze, those of the problems ``chosen (N, W)``; others have nothing to hold."""
    contact_mask = np.repeat(chosen.any(1), sets.sizes)
    squeeze = np.where(contact_mask, sets.squeeze * sets.squeeze.dtype.type(LITTLE), 0).astype(sets.squeeze.dtype)
    wrench = np.where(chosen[..., None], sets.wrench, 0).astype(sets.wrench.dtype)
    return replace(sets, squeeze=squeeze, wrench=wrench)


TILE = 1 << 14
"""Contacts that are computed at a time."""


def margins(sets: ContactSets, forces: np.ndarray, moments: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
    """Compute the smallest friction margin of loaded contacts [rad] and the largest force beyond friction's limit [N].

    Both ``(N, W)``, for ``forces (M, W, 3)`` and, of soft fingers, ``moments (M, W)``. The margin is +inf where no
    contact is loaded; what is beyond the limit is max(|t| - mu n) or 0, moments counted as in ``friction_margin``.
    """
    shape = (len(sets), sets.wrenches)
    if not len(sets.points):
        return np.full(shape, np.inf, sets.points.dtype), np.zeros(shape, sets.points.dtype)
    margin, beyond = np.empty(forces.shape[:2], forces.dtype), np.empty(forces.shape[:2], forces.dtype)
    for wrench in range(sets.wrenches):
        for first in range(0, len(sets.points), TILE):
            tile = slice(first, first + TILE)
            torsion = None if sets.torsion is None else sets.torsion[tile]
            moment = None if moments is None else moments[tile, wrench]
            arrays = (sets.normals[tile], sets.friction[tile], torsion, forces[tile, wrench], moment)
            count = len(arrays[1])
            results = _program()(jax.tree.map(partial(widened, missing=TILE - count), arrays))
            margin[tile, wrench], beyond[tile, wrench] = (np.asarray(values)[:count] for values in results)
    starts = sets.offsets[:-1]
    return np.minimum.reduceat(margin, starts), np.maximum(np.maximum.reduceat(beyond, starts), 0)


@cache
def _program() -> Any:
    return jit_here(_contact_margins)


def _contact_margins(contact_arrays: tuple[Array | None, ...]) -> tuple[Array, Array]:
    """Compute the margin and the tangential force beyond friction's limit of each contact, as a grasp of its own."""
    normals, friction, torsion, forces, moments = jax.tree.map(
        lambda array: jnp.asarray(array)[:, None], contact_arrays
    )
    grasp = Grasp(jnp.zeros_like(normals), normals, friction, jnp.zeros_like(friction), torsion=torsion)
    force, normal = vec3.from_axis(forces, -1), vec3.from_axis(normals, -1)
    across, spin = vec3.norm(vec3.cross(normal, force)), spin_force(grasp, moments)
    if spin is not None:
        across = jnp.hypot(across, spin)
    # |t| - mu n: above zero outside of the cone.
    beyond = across - friction * vec3.dot(force, normal)
    return friction_margin(grasp, forces, moments)[:, 0], beyond[:, 0]


APART = TOLERANCE
"""Relative distance of a measure's bounds from which on a grasp counts as undecided."""


def measure_all(measures: tuple[Measure, ...], sets: ContactSets, progress: Progress | None = None) -> Columns:
    """Compute every measure of every grasp: arrays ``(N,)`` by ``MEASURE.COLUMN``.

    Grasps are measured a few hundred at a time; ``progress`` is told the number of each part.
    """
    if not measures:
        return {}
    width, parts = max(1, sets.largest), []
    for start in range(0, max(len(sets), 1), TOGETHER):
        subset = sets.rows(slice(start, start + TOGETHER))
        measured = MeasuredGrasps(subset.padded(width), subset.wrench, subset.limits(width))
        parts.append(
            {
                f"{measure.name}.{column}": values
                for measure in measures
                for column, values in measure.columns(measured).items()
            }
        )
        if progress is not None:
            progress(len(subset))
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def least_friction_of(sets: ContactSets) -> np.ndarray:
    """Compute the least factor on their friction with which sets hold, ``(N, W)``; +inf where no friction suffices.

    The total of normal forces is that of the squeezing forces of the hand.
    """
    grasp = sets.padded(max(1, sets.largest))
    factors = [np.asarray(least_friction(grasp, sets.wrench[:, k], "uniform")) for k in range(sets.wrenches)]
    return np.stack(factors, 1)


@dataclass
class QualitySummary:
    """Summary of a measure over all grasps."""

    values: LogHistogram
    """Distribution of the measure's first column; numbers below zero count as zero."""
    undecided: int = 0
    """Grasps whose closure is not decided, or whose bounds are further apart than ``APART``."""

    def merged(self, summary: "QualitySummary") -> "QualitySummary":
        return QualitySummary(self.values.merged(summary.values), self.undecided + summary.undecided)

    def to_json(self) -> dict:
        return {"values": self.values.to_json(), "undecided": self.undecided}

    @classmethod
    def from_json(cls, data: dict) -> "QualitySummary":
        return cls(LogHistogram.from_json(data["values"]), data["undecided"])


def summarise_qualities(measures: tuple[Measure, ...], columns: Columns) -> dict[str, QualitySummary]:
    """Summarise the measures of a chunk, by the measures' names."""
    summaries = {}
    for measure in measures:
        values = next(array for name, array in columns.items() if name.startswith(f"{measure.name}."))
        unknown = _is_undecided(measure.name, values, columns)
        summaries[measure.name] = QualitySummary(LogHistogram.of(np.maximum(values, 0)), int(unknown.sum()))
    return summaries


def _is_undecided(name: str, values: np.ndarray, columns: Columns) -> np.ndarray:
    """Return a mask ``(N,)`` of the grasps that a measure leaves open; ``values`` is its first column."""
    if values.dtype == np.int8:
        return values == UNDECIDED
    lower, upper = columns.get(f"{name}.lower"), columns.get(f"{name}.upper")
    if lower is None or upper is None:
        return np.zeros(len(values), bool)
    return lower < (1 - APART) * upper


def quality_line(name: str, summary: QualitySummary) -> str:
    """Format the summary of a measure as a line of text."""
    values = summary.values
    if name == "force-closure":
        closed = int(values.counts.sum())
        text = f"{name:22}{_share(closed, values.total)} closed"
        return text + (f", {_share(summary.undecided, values.total)} undecided" if summary.undecided else "")
    # Those of a histogram are known to half of its bins; the largest is exact.
    quantiles = [f"{label} ~{values.quantile(share):.2g}" for label, share in _QUANTILES]
    joined = "  ".join([*quantiles, f"largest {values.quantile(1.0):.3g}"])
    none = f"  {_share(values.zeros, values.total)} none" if values.zeros else ""
    apart = f"  {_share(summary.undecided, values.total)} with bounds more than {100 * APART:g} % apart"
    return f"{name:22}{joined}{none}" + (apart if summary.undecided else "")


_QUANTILES = (("5%", 0.05), ("median", 0.5), ("95%", 0.95))


def _share(count: int, total: int) -> str:
    return f"{100 * count / max(1, total):.1f} %"
