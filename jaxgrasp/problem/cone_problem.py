"""A flat batch of problems as cone programs see it: units of the load, and each contact's force in its own cone.

Nothing is shared among the problems: every array has as many entries as there are.

The force of a contact is y = (normal, tangential): the latter is what it uses of its friction along two tangents and,
of a soft finger, about its normal, and |tangential| <= normal is the friction cone whatever the coefficients.

What limits add to a cone program: inequalities row.x <= end by name, and their multipliers by the same name.
"""

from dataclasses import replace
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jax import Array, lax

from jaxgrasp.model.grasp import Grasp
from jaxgrasp.numerics.cone_program import Cones
from jaxgrasp.numerics.geometry import tangents
from jaxgrasp.numerics.vec3 import safe_divide
from jaxgrasp.problem.batch_last import ProblemBatch, TorqueBounds
from jaxgrasp.problem.wrench_discs import WrenchDiscs, discs, scaled_wrench


class Units(NamedTuple):
    """Units in which a problem is scaled: constants where derivatives are taken."""

    about: Array
    """``(B, 3)`` [m]."""
    length: Array
    """``(B,)`` [m]."""
    force_unit: Array
    """``(B,)`` [N]: size of the wrench, and of least normal forces where there are any."""
    torque: Array
    """``(B,)``: of joints, for each newton of a contact."""


class ConeProblem(NamedTuple):
    """Problems in these units."""

    columns: Array
    """Wrench of each component of y ``(B, 6, n, c)``; c is 3, or 4 with soft fingers."""
    right: Array
    """The wrench ``(B, 6)``."""
    friction: Array
    """``(B, n)``."""
    present: Array
    normal_min: Array | None
    """Least normal force of each contact ``(B, n)``; None where none is bounded, and so for ``normal_max``."""
    normal_max: Array | None
    rows: Array | None
    """Torque of each component of y ``(B, j, n, c)``; None where no joint is known."""
    torque_max: Array | None

    @property
    def width(self) -> int:
        """Numbers of all contacts."""
        return self.columns.shape[2] * self.columns.shape[3]


def units_of(problem: ProblemBatch) -> Units:
    problem = lax.stop_gradient(problem)
    shapes = discs(_grasp(problem))
    wrench = scaled_wrench(problem.wrench, shapes.about, shapes.length, jnp)
    size = jnp.sqrt(jnp.sum(wrench**2, -1))
    if problem.normal_min is not None:
        size = size + jnp.sum(jnp.where(_present(problem), problem.normal_min, 0), -1)
    load = jnp.where(size > 0, size, 1)
    torque = jnp.ones_like(load)
    if problem.torque_bounds is not None:
        rows = _rows(problem, shapes)
        largest = jnp.max(jnp.sqrt(jnp.sum(rows**2, (2, 3))), -1)
        torque = jnp.where(largest > 0, largest, 1)
    return Units(jnp.asarray(shapes.about), jnp.asarray(shapes.length), load, torque)


def cone_problem(problem: ProblemBatch, units: Units) -> ConeProblem:
    shapes = discs(_grasp(problem), units.length, units.about)
    load, present = units.force_unit[:, None], _present(problem)
    spans = shapes.spans if problem.torsion is not None else shapes.spans[..., :2]
    columns = jnp.concatenate([shapes.centres[..., None], spans], -1).transpose(0, 2, 1, 3)
    bounds, torque = problem.torque_bounds, units.torque[:, None]
    rows = None if bounds is None else _rows(problem, shapes) / torque[..., None, None]
    return ConeProblem(
        columns=columns,
        right=scaled_wrench(problem.wrench, shapes.about, shapes.length, jnp) / load,
        friction=jnp.where(present, problem.friction, 0),
        present=present,
        normal_min=None if problem.normal_min is None else jnp.where(present, problem.normal_min / load, 0),
        normal_max=None if problem.normal_max is None else jnp.where(present, problem.normal_max / load, jnp.inf),
        rows=rows,
        torque_max=None if bounds is None else bounds.torque_max / (load * torque),
    )


def _grasp(problem: ProblemBatch) -> Grasp:
    return Grasp(
        problem.points, problem.normals, problem.friction, problem.squeeze, problem.present, torsion=problem.torsion
    )


def _present(problem: ProblemBatch) -> Array:
    return jnp.ones(problem.friction.shape, bool) if problem.present is None else problem.present > 0.5


def _rows(problem: ProblemBatch, shapes: WrenchDiscs) -> Array:
    """Joint torques of each component of y ``(B, j, n, c)``."""
    assert problem.torque_bounds is not None
    present = _present(problem)
    torque_map = jnp.where(present[..., None, None], problem.torque_bounds.torque_map, 0)
    # The normals, and the tangents that the spans are made along.
    normals = jnp.where(present[..., None], jnp.asarray(shapes.centres)[..., :3], jnp.eye(3, dtype=torque_map.dtype)[2])
    friction = jnp.where(present, problem.friction, 0)
    parts = [normals, *(friction[..., None] * t for t in tangents(normals))]
    rows = [jnp.einsum("bncj,bnc->bjn", torque_map[:, :, :3], jnp.where(present[..., None], part, 0)) for part in parts]
    if problem.torsion is not None:
        turning = jnp.where(present & (problem.friction > 0), problem.torsion, 0)
        spun = torque_map[:, :, 3] if torque_map.shape[2] == 4 else jnp.zeros_like(torque_map[:, :, 0])
        rows.append(jnp.einsum("bnj,bn->bjn", spun, turning))
    return jnp.stack(rows, -1)


def forces_of_y(conic: ConeProblem, units: Units, problem: ProblemBatch, y: Array) -> tuple[Array, Array | None]:
    """Return forces ``(B, n, 3)`` and, for soft fingers, moments of y ``(B, n, c)``, in the user's units."""
    y = jnp.where(conic.present[..., None], y, 0) * units.force_unit[:, None, None]
    # The first three rows of a column are a force.
    forces = jnp.einsum("bxnc,bnc->bnx", conic.columns[:, :3], y, precision=lax.Precision.HIGHEST)
    if problem.torsion is None:
        return forces, None
    turning = jnp.where(conic.present & (problem.friction > 0), problem.torsion, 0)
    return forces, turning * y[..., 3]


def y_of_forces(conic: ConeProblem, units: Units, problem: ProblemBatch, forces: Array, moments: Array | None) -> Array:
    """y ``(B, n, c)`` of forces, the inverse of ``forces_of_y``."""
    # Columns of friction are friction times a tangent.
    along = jnp.einsum("bxnc,bnx->bnc", conic.columns[:, :3, :, :3], forces, precision=lax.Precision.HIGHEST)
    parts = [along[..., :1], safe_divide(along[..., 1:], conic.friction[..., None] ** 2)]
    if moments is not None and problem.torsion is not None:
        parts.append(safe_divide(moments, jnp.where(conic.present, problem.torsion, 0))[..., None])
    return jnp.concatenate(parts, -1) / units.force_unit[:, None, None]


def residual_norm(conic: ConeProblem, y: Array) -> Array:
    """Return the norm of the wrench residual ``(B,)``."""
    residual = conic.right - jnp.einsum("bxnc,bnc->bx", conic.columns, y, precision=lax.Precision.HIGHEST)
    return jnp.sqrt(jnp.sum(residual**2, -1))


def friction_cones(conic: ConeProblem, extra: int) -> Cones:
    """y of each contact in its cone; of absent ones nothing. ``extra`` variables follow those of y."""
    size, _, n, c = conic.columns.shape
    blocks = -jnp.eye(n * c, dtype=conic.columns.dtype).reshape(n, c, n * c)
    rows = jnp.where(conic.present[..., None, None], blocks, 0)
    offset = jnp.where(conic.present[..., None], jnp.zeros(c), jnp.eye(c)[0]).astype(rows.dtype)
    return Cones(jnp.pad(rows, [(0, 0)] * 3 + [(0, extra)]), jnp.broadcast_to(offset, (size, n, c)))


def absent(conic: ConeProblem, extra: int) -> Array:
    """Return a quadratic term that keeps absent contacts at zero ``(B, k, k)``."""
    c = conic.columns.shape[3]
    idle = jnp.repeat((~conic.present).astype(conic.right.dtype), c, -1)
    return jnp.pad(idle, [(0, 0), (0, extra)])[..., None] * jnp.eye(conic.width + extra, dtype=conic.right.dtype)


def normal_force_rows(conic: ConeProblem, extra: int) -> Array:
    """Return the rows ``(n, k)`` whose products with y are the normal forces."""
    n, c = conic.columns.shape[2:]
    return jnp.pad(jnp.eye(n * c, dtype=conic.right.dtype)[::c], [(0, 0), (0, extra)])


def restrict_to(problem: ProblemBatch, mask: Array) -> ProblemBatch:
    """Keep the problems where ``mask`` is true; the others become trivial: no steps, no NaN."""
    present = jnp.ones_like(problem.friction) if problem.present is None else problem.present
    wrench = jnp.where(mask[:, None], problem.wrench, 0)
    replaced = eqx.tree_at(
        lambda p: (p.present, p.wrench),
        problem,
        (jnp.where(mask[:, None], present, 0), wrench),
        is_leaf=lambda x: x is None,
    )
    bounds = problem.torque_bounds
    if bounds is None:
        return replaced
    return replace(
        replaced, torque_bounds=TorqueBounds(bounds.torque_map, jnp.where(mask[:, None], bounds.torque_max, jnp.inf))
    )


Inequalities = dict[str, tuple[Array, Array]]
"""Rows ``(B, m, k)`` and ends ``(B, m)``; an infinite end is none."""


def limits_of(conic: ConeProblem, extra: int) -> Inequalities:
    """Bounds of normal forces and of torques."""
    size, n = conic.right.shape[0], conic.columns.shape[2]
    rows = jnp.broadcast_to(normal_force_rows(conic, extra), (size, n, conic.width + extra))
    inequalities: Inequalities = {}
    if conic.normal_min is not None:
        inequalities["normal_min"] = -rows, -conic.normal_min
    if conic.normal_max is not None:
        inequalities["normal_max"] = rows, conic.normal_max
    if conic.rows is not None and conic.torque_max is not None:
        torque = jnp.pad(conic.rows.reshape(size, -1, conic.width), [(0, 0), (0, 0), (0, extra)])
        inequalities["up"] = torque, conic.torque_max
        inequalities["down"] = -torque, conic.torque_max
    return inequalities


def as_cones(inequalities: Inequalities) -> Cones:
    """All of them, as cones of one dimension."""
    rows = jnp.concatenate([rows for rows, _ in inequalities.values()], 1)
    ends = jnp.concatenate([ends for _, ends in inequalities.values()], 1)
    holds = jnp.isfinite(ends)
    return Cones(jnp.where(holds[..., None], rows, 0)[:, :, None], jnp.where(holds, ends, 1)[..., None])


def inequality_multipliers(inequalities: Inequalities, duals: Array) -> dict[str, Array]:
    """Return the duals of ``as_cones``, ``(B, m, 1)``, by name ``(B, m)``; zero for infinite bounds."""
    multipliers, first = {}, 0
    for name, (_, ends) in inequalities.items():
        last = first + ends.shape[1]
        multipliers[name] = jnp.where(jnp.isfinite(ends), duals[:, first:last, 0], 0)
        first = last
    return multipliers
