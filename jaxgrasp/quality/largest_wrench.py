"""Largest wrench along a direction that bounded normal forces exert, between two proven bounds."""

from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxgrasp.model.arguments import Progress
from jaxgrasp.model.arrays import AnyArray, Float
from jaxgrasp.model.faults import Fault, GraspError
from jaxgrasp.model.grasp import Grasp
from jaxgrasp.problem.wrench_discs import discs, scaled_wrench, work
from jaxgrasp.quality.closure import forces_of, unscaled, weights_or_twist
from jaxgrasp.quality.grasp_input import (
    GraspInput,
    call_on_host,
    check_tolerance,
    in_turn,
    is_traced,
    range_of,
    read_grasps,
    with_derivative_of,
)
from jaxgrasp.quality.simplex_steps import SimplexBases, WrenchColumns
from jaxgrasp.quality.wrench_sets import Bound, WrenchSet, WrenchSets, check_bound, check_sides, pyramid
from jaxgrasp.validation.checked import checked

if TYPE_CHECKING:
    from scipy.optimize import OptimizeResult

ROUNDS = 60
"""Linear programs for one grasp; most need about ten."""
FEASIBLE = 1e-10
"""Feasibility tolerance of HiGHS, the least that it accepts."""
PIVOTS = 300
"""Steps of the simplex method, which needs some twenty, and more for more digits; the rest goes to HiGHS."""
REACHED = 1e3
"""Multiples of rounding under which what is reached is nothing, along twists that may be long."""
WORTHLESS = 1e-13
"""Gain by a column that is none."""
BALANCED = 1e-9
"""Largest error of the wrench of the lower bound's forces, relative to that wrench; the error is rounding."""


class LargestWrench(NamedTuple):
    """Bounds of the largest multiple of a task that the grasps of a batch exert, with their proofs."""

    lower: np.ndarray
    """``(...)``: the ``forces`` exert this multiple."""
    upper: np.ndarray
    """``(...)``: none exert more, as the twist proves."""
    twist: np.ndarray
    """``(..., 6)``: (linear, angular) about the frame's origin, of power 1 on the task: allowed forces work along it
    at most at the rate ``upper``."""
    forces: np.ndarray
    """``(..., n, 3)``."""
    moments: np.ndarray
    """``(..., n)`` [m]: of soft fingers about their normals."""
    normal_force: np.ndarray
    """``(..., n)``: normal forces."""
    tangential: np.ndarray
    """``(..., n, 3)``: parts of the largest friction along two tangents, and of a soft finger's moment, times that
    force."""

    def __str__(self) -> str:
        return f"LargestWrench: upper bound {range_of(self.upper)}"


@checked
def largest_wrench(
    grasp: Grasp,
    task: Float[AnyArray, "*#batch 6"],
    bound: Bound = "linf",
    *,
    sides: int | None = None,
    tol: float = 1e-6,
    progress: Progress | None = None,
) -> LargestWrench:
    """Compute the largest alpha for which forces inside the friction cones exert alpha times the task.

    Their normal forces have a sum of at most 1 (``"l1"``: then it is 1 over [`jaxgrasp.least_squeeze`][] of the task)
    or are at most 1 each (``"linf"``). For another limit of the forces multiply alpha by it; for the own limits of each
    contact and joint ask [`jaxgrasp.wrench_margin`][]. Neither a length nor a point matters here: torques are not
    compared with forces.

    The cones are approached from inside by wrenches that the answers of one linear program after the other, and
    their multipliers, call for: a twist d with d.task = 1 along which forces work at most at the rate h(d), so that
    no alpha is larger. The lower bound's forces exert their wrench, the upper bound holds, within rounding of the
    data, which is added to the upper one.

    Inside ``jit``, ``vmap`` and ``grad`` it calls the host back, nothing is checked, and results are JAX arrays in the
    precision of the points, NaN for a task that cannot be used; it reports no progress. Both bounds then have the
    derivative of ``largest_wrench_at``.

    Args:
        grasp: contacts ``(..., n)``.
        task: the wrench ``(..., 6)``, not zero [N, N.m]; its leading axes broadcast to the grasps'.
        bound: what is bounded.
        sides: as for [`jaxgrasp.quality.ferrari_canny`][].
        tol: relative distance of the bounds at which the search ends.
        progress: as for [`jaxgrasp.quality.ferrari_canny`][].

    Raises:
        GraspError: for the first entry that is not usable, before anything is computed.
        ValueError: for an unknown bound, or other options that cannot be used.
    """
    check_bound(bound)
    check_sides(sides)
    check_tolerance(tol)
    if is_traced(grasp, task):
        return _traced(grasp, task, bound, sides, tol)
    inputs = read_grasps(grasp)
    tasks = _scaled_tasks(task, inputs)
    corners = None if sides is None else pyramid(sides, inputs.soft)
    size = np.linalg.norm(tasks, axis=-1)
    bodies = replace(inputs.bodies(), bound=bound, corners=corners)
    units = (tasks / size[..., None]).reshape(-1, 6)
    parts = in_turn(len(units), lambda indices: _bound_tasks(bodies.take(indices), units[indices], tol), progress)
    proofs = _TaskBoundsBatch(*parts)
    batch, contacts = inputs.batch, inputs.present.shape
    lower, upper = (array.reshape(batch) / size for array in (proofs.lower, proofs.upper))
    twist = unscaled(proofs.twist.reshape((*batch, 6)) / size[..., None], inputs.shapes, np)
    normal_force, tangential = proofs.normal_force.reshape(contacts), proofs.tangential.reshape((*contacts, 3))
    return LargestWrench(
        lower, upper, twist, *forces_of(inputs.shapes, normal_force, tangential, np), normal_force, tangential
    )


def _traced(grasp: Grasp, task: AnyArray, bound: Bound, sides: int | None, tol: float) -> LargestWrench:
    count, batch = grasp.friction.shape[-1], grasp.points.shape[:-2]
    corners = None if sides is None else pyramid(sides, grasp.torsion is not None)
    frame = discs(grasp)
    tasks = jnp.broadcast_to(jnp.asarray(task, frame.length.dtype), (*batch, 6))
    scaled = scaled_wrench(tasks, frame.about, frame.length, jnp)
    size = jnp.sqrt(jnp.sum(jax.lax.stop_gradient(scaled) ** 2, -1))

    def question(bodies: WrenchSets, tasks: np.ndarray) -> tuple[np.ndarray, ...]:
        usable = np.isfinite(tasks).all(1)
        units = np.where(usable[:, None], tasks, np.eye(6)[0])
        proofs = _bound_tasks(replace(bodies, bound=bound, corners=corners), units, tol)
        return np.where(usable, proofs.lower, np.nan), np.where(usable, proofs.upper, np.nan), *proofs[2:]

    unit = jax.lax.stop_gradient(scaled) / size[..., None]
    trailing = ((), (), (6,), (count,), (count, 3))
    shapes, (lower, upper, twist, normal_force, tangential) = call_on_host(
        question, trailing, grasp, None, None, extra=(unit,)
    )
    along = jnp.sum(twist * scaled, -1)
    multiple = work(shapes, normal_force, tangential, twist) / jnp.where(along > 0, along, 1)
    lower, upper = (with_derivative_of(bounds / size, multiple) for bounds in (lower, upper))
    frame = jax.lax.stop_gradient(shapes)
    solution: Any = LargestWrench(
        lower,
        upper,
        unscaled(twist / size[..., None], frame, jnp),
        *forces_of(frame, normal_force, tangential, jnp),
        normal_force,
        tangential,
    )
    return solution


@checked
def largest_wrench_at(
    grasp: Grasp, task: Float[AnyArray, "*#batch 6"], measurement: LargestWrench
) -> Float[Array, "..."]:
    """Evaluate the largest multiple near a grasp and task measured by ``largest_wrench``, to differentiate it.

    By the envelope theorem it is the work of the measured forces along the measured twist, over that of the task.
    First derivatives only; where several twists bound the answer, those of one. Its value is that of
    ``measurement.lower`` and ``measurement.upper`` within their distance.

    Args:
        grasp: the grasp measured, of JAX arrays; works under ``jit``, ``vmap`` and ``grad``.
        task: the task measured.
        measurement: what ``largest_wrench`` returned, with any bound and any pyramids.
    """
    return _compiled_multiple(grasp, task, measurement)


@jax.jit
def _compiled_multiple(grasp: Grasp, task: Array, measurement: LargestWrench) -> Array:
    dtype = grasp.points.dtype
    normal_force, tangential, twist = (
        array.astype(dtype) for array in (measurement.normal_force, measurement.tangential, measurement.twist)
    )
    shapes = discs(grasp, length=1.0, about=jnp.zeros(3, dtype))
    return work(shapes, normal_force, tangential, twist) / jnp.sum(twist * task, -1)


def _scaled_tasks(task: AnyArray, inputs: GraspInput) -> np.ndarray:
    """Check tasks and scale them to wrenches ``(..., 6)`` about the contacts' middle."""
    array = np.asarray(task, np.float64)
    shape = (*inputs.batch, 6)
    try:
        tasks = np.broadcast_to(array, shape)
    except ValueError:
        expected = f"a shape that broadcasts to {shape}, as points imply"
        raise GraspError(Fault("task", (), f"an array of shape {array.shape}", expected)) from None
    for index in np.argwhere(~(np.isfinite(tasks).all(-1) & (tasks != 0).any(-1))):
        position = tuple(map(int, index))
        raise GraspError(Fault("task", position, str(tasks[position]), "six finite numbers, not all zero [N, N.m]"))
    return scaled_wrench(tasks, inputs.shapes.about, inputs.shapes.length, np)


class _TaskBounds(NamedTuple):
    """Bounds of the largest multiple of a task that one grasp exerts, with their proofs, in scaled units."""

    lower: float
    upper: float
    twist: np.ndarray
    normal_force: np.ndarray
    tangential: np.ndarray


class _TaskBoundsBatch(NamedTuple):
    """Bounds and proofs of many grasps as arrays ``(G, ...)``, with the fields of ``_TaskBounds``."""

    lower: np.ndarray
    upper: np.ndarray
    twist: np.ndarray
    normal_force: np.ndarray
    tangential: np.ndarray

    def improve(self, indices: np.ndarray, candidates: "_TaskBoundsBatch") -> None:
        """Replace the bounds of the grasps ``indices`` by those candidates that are tighter."""
        lower, upper = candidates.upper < self.upper[indices], candidates.lower > self.lower[indices]
        self.upper[indices[lower]], self.twist[indices[lower]] = candidates.upper[lower], candidates.twist[lower]
        for array, replacement in (
            (self.lower, candidates.lower),
            (self.normal_force, candidates.normal_force),
            (self.tangential, candidates.tangential),
        ):
            array[indices[upper]] = replacement[upper]


def _bound_tasks(bodies: WrenchSets, tasks: np.ndarray, tol: float) -> _TaskBoundsBatch:
    """Compute the bounds for unit tasks ``(G, 6)`` side by side, then grasp by grasp where these stay apart."""
    grasps, count = bodies.present.shape
    normal_force, tangential = np.zeros((grasps, count)), np.zeros((grasps, count, 3))
    proofs = _TaskBoundsBatch(np.zeros(grasps), np.full(grasps, np.inf), tasks.copy(), normal_force, tangential)
    _by_simplex(bodies, tasks, tol, proofs)
    _by_twist(bodies, tasks, np.flatnonzero(proofs.lower < (1 - tol) * proofs.upper), proofs)
    for index in np.flatnonzero((proofs.lower < (1 - tol) * proofs.upper) & (proofs.upper > REACHED * bodies.slack)):
        body, present = bodies.alone(int(index)), bodies.present[index]
        single = _bound_task(body, tasks[index], tol)
        wide = np.zeros((1, count)), np.zeros((1, count, 3))
        wide[0][0, present], wide[1][0, present] = single.normal_force, single.tangential
        bounds = np.array([single.lower]), np.array([single.upper])
        proofs.improve(np.array([index]), _TaskBoundsBatch(*bounds, single.twist[None], *wide))
    # Forces miss their wrench by rounding, which a long twist makes large: the upper bound allows for it.
    np.minimum(proofs.lower, proofs.upper, out=proofs.lower)
    return proofs


def _by_twist(bodies: WrenchSets, tasks: np.ndarray, indices: np.ndarray, proofs: _TaskBoundsBatch) -> None:
    """Bound tasks that are out of reach altogether by a twist along which they work and no contact does."""
    chosen = bodies.take(indices)
    twist = weights_or_twist(WrenchColumns.of(chosen.alone_edges()), tasks[indices].T)[-1].T
    power = np.sum(twist * tasks[indices], 1)
    twist = twist / np.where(power > 0, power, 1)[:, None]
    height = chosen.reach(twist).height + chosen.slack * np.linalg.norm(twist, axis=1)
    fields = (
        np.zeros(len(indices)),
        np.where(power > 0, height, np.inf),
        twist,
        proofs.normal_force[indices],
        proofs.tangential[indices],
    )
    proofs.improve(indices, _TaskBoundsBatch(*fields))


def _by_simplex(bodies: WrenchSets, tasks: np.ndarray, tol: float, proofs: _TaskBoundsBatch) -> None:
    """Solve column by column: each enters a contact's wrench that works most along the twist of the others.

    Rows are the six of the balance and one for each bound of forces; the slack of a bound is a column too.
    """
    grasps, count = bodies.present.shape
    bounds = 1 if bodies.bound == "l1" else count
    owner = np.zeros(count, int) if bounds == 1 else np.arange(count)
    right = np.concatenate([np.zeros((6, grasps)), np.ones((bounds, grasps))])
    bases = SimplexBases.artificial(right, 0.0)
    bases.columns[6:] = count + np.arange(bounds)[:, None]
    tangentials, slack = np.zeros((len(right), 3, grasps)), bodies.slack
    multiple = np.full(grasps, count + bounds)
    bases.enter(np.concatenate([-tasks.T, np.zeros((bounds, grasps))]), -np.ones(grasps), multiple)
    remaining, absent, wrenches, along = np.arange(grasps), ~bodies.present.T, WrenchColumns.of(bodies), tasks.T
    for _ in range(PIVOTS):
        programs, multipliers = np.arange(len(remaining)), bases.multipliers()
        values, tangential = wrenches.supports(multipliers[:6])
        power = np.sum(multipliers[:6] * along, 0)
        height = np.maximum(values, 0)
        height = height.max(0, initial=0) if bounds == 1 else height.sum(0)
        height += slack[remaining] * np.linalg.norm(multipliers[:6], axis=0)
        works = power > 0
        twist, upper = (
            np.where(works, array / np.where(works, power, 1), np.inf) for array in (multipliers[:6], height)
        )
        exerted = _exerted(wrenches, bodies.bound, bases, tangentials, along)
        proofs.improve(remaining, _TaskBoundsBatch(exerted[0], upper, twist.T, *exerted[1:]))
        gains = np.concatenate([np.where(absent, -np.inf, values + multipliers[6 + owner]), multipliers[6:]])
        best = np.argmax(gains, 0)
        close = proofs.lower[remaining] >= (1 - tol) * proofs.upper[remaining]
        close |= (proofs.upper[remaining] <= slack[remaining]) | (gains[best, programs] <= WORTHLESS)
        columns, contact = _columns(wrenches, best, tangential, owner, bounds)
        position = bases.enter(columns, np.zeros(len(remaining)), best)
        unfinished = np.flatnonzero(~close & (position >= 0))
        if not len(unfinished):
            break
        entered = np.where(best < count, tangential[contact, :, programs].T, 0)
        tangentials[position[unfinished], :, unfinished] = entered[:, unfinished].T
        if len(unfinished) < len(remaining):
            remaining, absent, wrenches, along = (
                remaining[unfinished],
                absent[:, unfinished],
                wrenches.take(unfinished),
                along[:, unfinished],
            )
            bases, tangentials = bases.take(unfinished), tangentials[..., unfinished]


def _columns(
    wrenches: WrenchColumns, best: np.ndarray, tangential: np.ndarray, owner: np.ndarray, bounds: int
) -> tuple[np.ndarray, np.ndarray]:
    """Build for each grasp the column of a contact's wrench, or of a bound's slack; return it and the contact."""
    count = len(owner)
    is_slack = best >= count
    contact = np.where(is_slack, 0, best)
    wrench = wrenches.of_contact(contact, tangential[contact, :, np.arange(len(best))].T)
    row = np.where(is_slack, best - count, owner[contact])
    counted = (np.arange(bounds)[:, None] == row).astype(float)
    return np.concatenate([np.where(is_slack, 0, wrench), counted]), contact


def _exerted(
    wrenches: WrenchColumns, bound: Bound, bases: SimplexBases, tangentials: np.ndarray, tasks: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Recompute the multiples of tasks ``(6, L)`` that the basic wrenches exert, and the forces that exert them.

    Returns multiples ``(L,)``, normal forces ``(L, n)`` and tangential forces ``(L, n, 3)``.
    """
    normal_force, tangential = bases.by_contact(tangentials, len(wrenches.discs))
    used = np.maximum(normal_force.sum(0) if bound == "l1" else normal_force.max(0, initial=0), 1)
    normal_force, tangential = normal_force / used, tangential / used
    wrench = wrenches.exerted(normal_force, tangential)
    multiple = np.sum(wrench * tasks, 0)
    error = np.linalg.norm(wrench - multiple * tasks, axis=0)
    multiple = np.where(error <= BALANCED * multiple, multiple, 0)
    return multiple, normal_force.T, np.moveaxis(tangential, -1, 0)


def _bound_task(body: WrenchSet, task: np.ndarray, tol: float) -> _TaskBounds:
    count = len(body.centres)
    best = _TaskBounds(0.0, np.inf, task, np.zeros(count), np.zeros((count, 3)))
    directions, owner, tangential = task[None], np.zeros(0, int), np.zeros((0, 3))
    if not count:
        return best._replace(upper=0.0)
    directions = np.concatenate([directions, np.eye(6), -np.eye(6)])
    for _ in range(ROUNDS):
        _, new = body.supports(directions)
        owner = np.concatenate([owner, np.tile(np.arange(count), len(directions))])
        tangential = np.concatenate([tangential, new.reshape(-1, 3)])
        points = body.centres[owner] + np.einsum("njk,nk->nj", body.spans[owner], tangential)
        program = _program(body, task, points, owner)
        if program.status != 0:
            return best
        twist, weights = program.eqlin.marginals, np.maximum(program.x[:-1], 0)
        best = _better(best, body, task, twist, weights, points, owner, tangential)
        if best.lower >= (1 - tol) * best.upper or best.upper <= body.slack:
            break
        directions = twist[None]
    return best


def _program(body: WrenchSet, task: np.ndarray, points: np.ndarray, owner: np.ndarray) -> "OptimizeResult":
    """Maximise alpha: weights of points sum up to alpha task, and those that a bound counts to 1 at most."""
    from scipy.optimize import linprog
    from scipy.sparse import csr_array

    columns = np.arange(len(points))
    rows = np.zeros(len(points), int) if body.bound == "l1" else owner
    counted = csr_array((np.ones(len(points)), (rows, columns)), (rows.max() + 1, len(points) + 1))
    return linprog(
        -np.eye(len(points) + 1)[-1],
        A_ub=counted,
        b_ub=np.ones(counted.shape[0]),
        A_eq=np.concatenate([points.T, -task[:, None]], 1),
        b_eq=np.zeros(6),
        method="highs-ds",
        options={"primal_feasibility_tolerance": FEASIBLE, "dual_feasibility_tolerance": FEASIBLE},
    )


def _better(
    best: _TaskBounds,
    body: WrenchSet,
    task: np.ndarray,
    twist: np.ndarray,
    weights: np.ndarray,
    points: np.ndarray,
    owner: np.ndarray,
    tangential: np.ndarray,
) -> _TaskBounds:
    """Improve the best bounds by those that a program's twist and weights prove, by arithmetic alone."""
    power = twist @ task
    if power > 0:
        twist = twist / power
        upper = float(body.reach(twist[None]).height[0]) + body.slack * np.linalg.norm(twist)
        if upper < best.upper:
            best = best._replace(upper=float(upper), twist=twist)
    count = len(body.centres)
    normal_force = np.bincount(owner, weights, count)
    used = normal_force.sum() if body.bound == "l1" else normal_force.max()
    weights = weights / max(used, 1)
    exerted = weights @ points
    lower = float(exerted @ task)
    if lower > best.lower and np.linalg.norm(exerted - lower * task) <= BALANCED * lower:
        by_contact = np.zeros((count, 3))
        np.add.at(by_contact, owner, weights[:, None] * tangential)
        best = best._replace(lower=lower, normal_force=np.bincount(owner, weights, count), tangential=by_contact)
    return best
