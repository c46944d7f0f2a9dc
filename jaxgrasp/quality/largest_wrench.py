"""Largest wrench along a direction that bounded normal forces exert, between two proven bounds."""

from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxgrasp.model.arrays import AnyArray, Float
from jaxgrasp.model.faults import Fault, GraspError
from jaxgrasp.model.grasp import Grasp
from jaxgrasp.model.progress import Progress
from jaxgrasp.problem.wrench_discs import discs, scaled_wrench, work
from jaxgrasp.quality.closure import forces_of, unscaled, weights_or_twist
from jaxgrasp.quality.grasp_input import GraspInput, check_tolerance, read_grasps
from jaxgrasp.quality.host_call import call_on_host, is_traced, moved
from jaxgrasp.quality.in_turn import in_turn
from jaxgrasp.quality.simplex_steps import SimplexBases
from jaxgrasp.quality.summary_line import range_of
from jaxgrasp.quality.wrench_columns import WrenchColumns
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
    given = read_grasps(grasp)
    tasks = _scaled_tasks(task, given)
    corners = None if sides is None else pyramid(sides, given.soft)
    size = np.linalg.norm(tasks, axis=-1)
    bodies = replace(given.bodies(), bound=bound, corners=corners)
    units = (tasks / size[..., None]).reshape(-1, 6)
    parts = in_turn(len(units), lambda own: _along_all(bodies.take(own), units[own], tol), progress)
    found = _AlongAll(*parts)
    batch, contacts = given.batch, given.present.shape
    lower, upper = (array.reshape(batch) / size for array in (found.lower, found.upper))
    twist = unscaled(found.twist.reshape((*batch, 6)) / size[..., None], given.shapes, np)
    normal_force, tangential = found.normal_force.reshape(contacts), found.tangential.reshape((*contacts, 3))
    return LargestWrench(
        lower, upper, twist, *forces_of(given.shapes, normal_force, tangential, np), normal_force, tangential
    )


def _traced(grasp: Grasp, task: AnyArray, bound: Bound, sides: int | None, tol: float) -> LargestWrench:
    count, batch = grasp.friction.shape[-1], grasp.points.shape[:-2]
    corners = None if sides is None else pyramid(sides, grasp.torsion is not None)
    frame = discs(grasp)
    tasks = jnp.broadcast_to(jnp.asarray(task, frame.length.dtype), (*batch, 6))
    scaled = scaled_wrench(tasks, frame.about, frame.length, jnp)
    size = jnp.sqrt(jnp.sum(jax.lax.stop_gradient(scaled) ** 2, -1))

    def question(bodies: WrenchSets, tasks: np.ndarray) -> tuple[np.ndarray, ...]:
        known = np.isfinite(tasks).all(1)
        units = np.where(known[:, None], tasks, np.eye(6)[0])
        found = _along_all(replace(bodies, bound=bound, corners=corners), units, tol)
        return np.where(known, found.lower, np.nan), np.where(known, found.upper, np.nan), *found[2:]

    unit = jax.lax.stop_gradient(scaled) / size[..., None]
    trailing = ((), (), (6,), (count,), (count, 3))
    shapes, (lower, upper, twist, normal_force, tangential) = call_on_host(
        question, trailing, grasp, None, None, each=(unit,)
    )
    along = jnp.sum(twist * scaled, -1)
    at = work(shapes, normal_force, tangential, twist) / jnp.where(along > 0, along, 1)
    lower, upper = (moved(bounds / size, at) for bounds in (lower, upper))
    frame = jax.lax.stop_gradient(shapes)
    found: Any = LargestWrench(
        lower,
        upper,
        unscaled(twist / size[..., None], frame, jnp),
        *forces_of(frame, normal_force, tangential, jnp),
        normal_force,
        tangential,
    )
    return found


@checked
def largest_wrench_at(grasp: Grasp, task: Float[AnyArray, "*#batch 6"], found: LargestWrench) -> Float[Array, "..."]:
    """Evaluate the largest multiple near a grasp and task measured by ``largest_wrench``, to differentiate it.

    By the envelope theorem it is the work of the forces found along the twist found, over that of the task.
    First derivatives only; where several twists bound the answer, those of one. Its value is that of ``found.lower``
    and ``found.upper`` within their distance.

    Args:
        grasp: the grasp measured, of JAX arrays; works under ``jit``, ``vmap`` and ``grad``.
        task: the task measured.
        found: what ``largest_wrench`` returned, with any bound and any pyramids.
    """
    return _worked(grasp, task, found)


@jax.jit
def _worked(grasp: Grasp, task: Array, found: LargestWrench) -> Array:
    dtype = grasp.points.dtype
    normal_force, tangential, twist = (
        array.astype(dtype) for array in (found.normal_force, found.tangential, found.twist)
    )
    shapes = discs(grasp, length=1.0, about=jnp.zeros(3, dtype))
    return work(shapes, normal_force, tangential, twist) / jnp.sum(twist * task, -1)


def _scaled_tasks(task: AnyArray, given: GraspInput) -> np.ndarray:
    """Check tasks and scale them to wrenches ``(..., 6)`` about the contacts' middle."""
    array = np.asarray(task, np.float64)
    wanted = (*given.batch, 6)
    try:
        tasks = np.broadcast_to(array, wanted)
    except ValueError:
        expected = f"a shape that broadcasts to {wanted}, as points imply"
        raise GraspError(Fault("task", (), f"an array of shape {array.shape}", expected)) from None
    for index in np.argwhere(~(np.isfinite(tasks).all(-1) & (tasks != 0).any(-1))):
        place = tuple(map(int, index))
        raise GraspError(Fault("task", place, str(tasks[place]), "six finite numbers, not all zero [N, N.m]"))
    return scaled_wrench(tasks, given.shapes.about, given.shapes.length, np)


class _Along(NamedTuple):
    """Bounds of the largest multiple of a task that one grasp exerts, with their proofs, in scaled units."""

    lower: float
    upper: float
    twist: np.ndarray
    normal_force: np.ndarray
    tangential: np.ndarray


class _AlongAll(NamedTuple):
    """Bounds and proofs of many grasps as arrays ``(G, ...)``, with the fields of ``_Along``."""

    lower: np.ndarray
    upper: np.ndarray
    twist: np.ndarray
    normal_force: np.ndarray
    tangential: np.ndarray

    def better(self, which: np.ndarray, other: "_AlongAll") -> None:
        """Take what is better of other bounds for some grasps."""
        lower, upper = other.upper < self.upper[which], other.lower > self.lower[which]
        self.upper[which[lower]], self.twist[which[lower]] = other.upper[lower], other.twist[lower]
        for own, theirs in (
            (self.lower, other.lower),
            (self.normal_force, other.normal_force),
            (self.tangential, other.tangential),
        ):
            own[which[upper]] = theirs[upper]


def _along_all(bodies: WrenchSets, tasks: np.ndarray, tol: float) -> _AlongAll:
    """Compute the bounds for unit tasks ``(G, 6)`` side by side, then grasp by grasp where these stay apart."""
    grasps, count = bodies.present.shape
    normal_force, tangential = np.zeros((grasps, count)), np.zeros((grasps, count, 3))
    found = _AlongAll(np.zeros(grasps), np.full(grasps, np.inf), tasks.copy(), normal_force, tangential)
    _by_simplex(bodies, tasks, tol, found)
    _by_twist(bodies, tasks, np.flatnonzero(found.lower < (1 - tol) * found.upper), found)
    for index in np.flatnonzero((found.lower < (1 - tol) * found.upper) & (found.upper > REACHED * bodies.slack)):
        body, own = bodies.alone(int(index)), bodies.present[index]
        one = _along(body, tasks[index], tol)
        wide = np.zeros((1, count)), np.zeros((1, count, 3))
        wide[0][0, own], wide[1][0, own] = one.normal_force, one.tangential
        bounds = np.array([one.lower]), np.array([one.upper])
        found.better(np.array([index]), _AlongAll(*bounds, one.twist[None], *wide))
    # Forces miss their wrench by rounding, which a long twist makes large: the upper bound allows for it.
    np.minimum(found.lower, found.upper, out=found.lower)
    return found


def _by_twist(bodies: WrenchSets, tasks: np.ndarray, which: np.ndarray, found: _AlongAll) -> None:
    """Bound tasks that are out of reach altogether by a twist along which they work and no contact does."""
    some = bodies.take(which)
    twist = weights_or_twist(WrenchColumns.of(some.alone_edges()), tasks[which].T)[-1].T
    power = np.sum(twist * tasks[which], 1)
    twist = twist / np.where(power > 0, power, 1)[:, None]
    height = some.reach(twist).height + some.slack * np.linalg.norm(twist, axis=1)
    none = (
        np.zeros(len(which)),
        np.where(power > 0, height, np.inf),
        twist,
        found.normal_force[which],
        found.tangential[which],
    )
    found.better(which, _AlongAll(*none))


def _by_simplex(bodies: WrenchSets, tasks: np.ndarray, tol: float, found: _AlongAll) -> None:
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
    left, absent, wrenches, along = np.arange(grasps), ~bodies.present.T, WrenchColumns.of(bodies), tasks.T
    for _ in range(PIVOTS):
        own, paid = np.arange(len(left)), bases.multipliers()
        values, tangential = wrenches.supports(paid[:6])
        power = np.sum(paid[:6] * along, 0)
        height = np.maximum(values, 0)
        height = height.max(0, initial=0) if bounds == 1 else height.sum(0)
        height += slack[left] * np.linalg.norm(paid[:6], axis=0)
        works = power > 0
        twist, upper = (np.where(works, array / np.where(works, power, 1), np.inf) for array in (paid[:6], height))
        exerted = _exerted(wrenches, bodies.bound, bases, tangentials, along)
        found.better(left, _AlongAll(exerted[0], upper, twist.T, *exerted[1:]))
        worth = np.concatenate([np.where(absent, -np.inf, values + paid[6 + owner]), paid[6:]])
        best = np.argmax(worth, 0)
        close = found.lower[left] >= (1 - tol) * found.upper[left]
        close |= (found.upper[left] <= slack[left]) | (worth[best, own] <= WORTHLESS)
        columns, contact = _columns(wrenches, best, tangential, owner, bounds)
        place = bases.enter(columns, np.zeros(len(left)), best)
        going = np.flatnonzero(~close & (place >= 0))
        if not len(going):
            break
        entered = np.where(best < count, tangential[contact, :, own].T, 0)
        tangentials[place[going], :, going] = entered[:, going].T
        if len(going) < len(left):
            left, absent, wrenches, along = left[going], absent[:, going], wrenches.take(going), along[:, going]
            bases, tangentials = bases.take(going), tangentials[..., going]


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
    missed = np.linalg.norm(wrench - multiple * tasks, axis=0)
    multiple = np.where(missed <= BALANCED * multiple, multiple, 0)
    return multiple, normal_force.T, np.moveaxis(tangential, -1, 0)


def _along(body: WrenchSet, task: np.ndarray, tol: float) -> _Along:
    count = len(body.centres)
    best = _Along(0.0, np.inf, task, np.zeros(count), np.zeros((count, 3)))
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
    best: _Along,
    body: WrenchSet,
    task: np.ndarray,
    twist: np.ndarray,
    weights: np.ndarray,
    points: np.ndarray,
    owner: np.ndarray,
    tangential: np.ndarray,
) -> _Along:
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
