"""Force closure: a test of whether contacts can hold their object against any disturbance, with a proof."""

from dataclasses import replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxgrasp.model.arguments import Progress
from jaxgrasp.model.grasp import Grasp
from jaxgrasp.problem.wrench_discs import About, Length, WrenchDiscs
from jaxgrasp.quality.grasp_input import (
    MANY_TOGETHER,
    call_on_host,
    count_of,
    in_turn,
    is_traced,
    range_of,
    read_grasps,
)
from jaxgrasp.quality.simplex_steps import SimplexBases, WrenchColumns
from jaxgrasp.quality.wrench_sets import WrenchSet, WrenchSets
from jaxgrasp.validation.checked import checked

ROUNDS = 60
"""Times that wrenches are added to those in sight of a question; it is decided within ten, near its limit later."""
BALANCED = 1e-13
"""Relative length of a sum of wrenches that counts as nothing: the answer that rests on it is checked for itself."""

SEPARATE = 1e-9
"""Relative distance of wrenches' hull from zero below which they may surround it but for lost digits."""
MAKE_BELIEVE = 1e8
"""Weights, relative to what they make up, that rounding alone may be behind."""
PRICE = 1e-9
"""Length that a unit of weight costs where it may be."""
PIVOTS = 80
"""Steps of the simplex method, which needs about ten, and some thirty near the limit of what is closed."""
EVEN = 1e-4
"""Least singular value of a discs' matrix, relative to the largest, with which plain arithmetic decides."""
CAUTIOUS = 1 - 1e-6
"""Share of a margin that remains after the rounding of its least singular value."""
AHEAD = 1e-3
"""Least power of wrenches against the unit twist that is sought: so the search ends within all bounds, not
against one of them, which it would come ever closer to."""
LESS = 0.1
"""Factor by which that power is reduced where no twist reaches it."""
UNMOVED = 1e-13
"""Power along a unit twist that is none in coordinates where the discs' matrix is a rotation."""
IDLE = 1e-6
"""Power of a contact along a unit twist, relative to its wrenches, that may be none but for lost digits."""


class ForceClosure(NamedTuple):
    """Verdicts on the force closure of a batch of grasps, with their proofs."""

    closed: np.ndarray
    """``(...)``: whether forces within friction balance any wrench; false too where that is undecided."""
    decided: np.ndarray
    """``(...)``: whether there is a proof; where not, rounding of the data decides."""
    margin: np.ndarray
    """``(...)``: where closed, a radius > 0 that the L1 ball of ``ferrari_canny`` has at least (it is often much
    larger); elsewhere the largest power of a contact along the twist, scaled to unit size, zero or less."""
    twist: np.ndarray
    """``(..., 6)``: where not closed, a velocity (linear, angular) about the frame's origin along which no contact can
    work: so the object can move; its size is one in scaled units, elsewhere zero."""
    forces: np.ndarray
    """``(..., n, 3)``: where closed, forces strictly inside the friction cones that balance each other; their normal
    forces sum to 1. Zeros elsewhere."""
    moments: np.ndarray
    """``(..., n)`` [m]: moments of soft fingers about their normals, per newton, that belong to the forces."""

    def __str__(self) -> str:
        open_ = np.asarray(self.decided) & ~np.asarray(self.closed)
        counts = {"closed": self.closed, "open": open_, "undecided": ~np.asarray(self.decided)}
        return f"ForceClosure: {count_of(counts)}; margin {range_of(self.margin)}"


class Decision(NamedTuple):
    """Verdict on the force closure of one grasp, with its proof, in scaled units."""

    closed: bool
    decided: bool
    margin: float
    twist: np.ndarray
    normal_force: np.ndarray
    tangential: np.ndarray


@checked
def force_closure(
    grasp: Grasp, *, length: Length = None, about: About = None, progress: Progress | None = None
) -> ForceClosure:
    """Decide whether a grasp can exert any wrench with forces that are large enough, and prove either answer.

    A grasp is closed if its discs' matrix has rank 6 and forces strictly inside the cones balance each other: then
    small changes of these exert any small wrench. It is open if a twist exists along which no contact can work. A
    frictionless contact is a ray, and any positive normal force of it is strictly inside.

    What rounding of the data, in their own precision, might turn over is undecided: a twist that
    contacts can work along by rounding alone counts as a proof that the grasp is open, since data a rounding
    away are open; but forces are a proof only where they outweigh rounding. So two hard contacts, and contacts whose
    wrenches miss a direction, are open.

    The answer depends on no length and no point; the size of the margin does, as that of
    [`jaxgrasp.quality.ferrari_canny`][].

    Inside ``jit`` and ``vmap`` it calls the host back, nothing is checked, and results are JAX arrays in the precision
    of the points; there are no derivatives.

    Args:
        grasp: contacts ``(..., n)``.
        length: what torques are divided by, ``(...)`` [m]; see [`jaxgrasp.quality.ferrari_canny`][].
        about: where torques are taken, ``(..., 3)`` [m]; likewise.
        progress: as for [`jaxgrasp.quality.ferrari_canny`][].

    Raises:
        GraspError: for the first entry that is not usable, before anything is computed.
    """
    if is_traced(grasp, length, about):
        return _traced(grasp, length, about)
    inputs = read_grasps(grasp, length, about)
    bodies = inputs.bodies()
    parts = in_turn(len(bodies.present), lambda indices: decide_all(bodies.take(indices)), progress, MANY_TOGETHER)
    decisions = Decisions(*parts)
    batch, contacts = inputs.batch, inputs.present.shape
    normal_force, tangential = decisions.normal_force.reshape(contacts), decisions.tangential.reshape((*contacts, 3))
    forces, moments = forces_of(inputs.shapes, normal_force, tangential, np)
    twist = unscaled(decisions.twist.reshape((*batch, 6)), inputs.shapes, np)
    closed, decided, margin = (
        array.reshape(batch) for array in (decisions.closed, decisions.decided, decisions.margin)
    )
    return ForceClosure(closed, decided, margin, twist, forces, moments)


def _traced(grasp: Grasp, length: Length, about: About) -> ForceClosure:
    count = grasp.friction.shape[-1]
    trailing = ((), (), (), (6,), (count,), (count, 3))
    shapes, (closed, decided, margin, twist, normal_force, tangential) = call_on_host(
        decide_all, trailing, grasp, length, about, together=MANY_TOGETHER
    )
    shapes = jax.lax.stop_gradient(shapes)
    forces, moments = forces_of(shapes, normal_force, tangential, jnp)
    return ForceClosure(closed > 0.5, decided > 0.5, margin, unscaled(twist, shapes, jnp), forces, moments)


def unscaled(twist: Any, shapes: WrenchDiscs, library: Any) -> Any:
    """Convert scaled twists ``(..., 6)`` to velocities (linear, angular) about the frame's origin, by NumPy or JAX."""
    angular = twist[..., 3:] / library.asarray(shapes.length)[..., None]
    return library.concatenate([twist[..., :3] - library.cross(angular, shapes.about), angular], -1)


def forces_of(shapes: WrenchDiscs, normal_force: Any, tangential: Any, library: Any) -> tuple[Any, Any]:
    """Compute forces ``(..., n, 3)`` and moments about the normals ``(..., n)`` [m], per newton, by NumPy or JAX."""
    exerted = normal_force[..., None] * shapes.centres + library.einsum("...njk,...nk->...nj", shapes.spans, tangential)
    moment = library.einsum("...j,...j->...", shapes.spans[..., 3:, 2], shapes.centres[..., :3])
    return exerted[..., :3], moment * tangential[..., 2] * library.asarray(shapes.length)[..., None]


class Decisions(NamedTuple):
    """Verdicts of many grasps as arrays ``(G, ...)``, with the fields of ``Decision``."""

    closed: np.ndarray
    decided: np.ndarray
    margin: np.ndarray
    twist: np.ndarray
    normal_force: np.ndarray
    """``(G, n)``, zeros for absent contacts."""
    tangential: np.ndarray
    """``(G, n, 3)``."""


def decide_all(bodies: WrenchSets) -> Decisions:
    """Decide the force closure of many grasps side by side, then of undecided ones singly, with more care."""
    grasps, count = bodies.present.shape
    decisions = Decisions(
        np.zeros(grasps, bool),
        np.zeros(grasps, bool),
        np.zeros(grasps),
        np.zeros((grasps, 6)),
        np.zeros((grasps, count)),
        np.zeros((grasps, count, 3)),
    )
    _decide_easy(bodies, decisions)
    for index in map(int, np.flatnonzero(~decisions.decided)):
        present, decision = bodies.present[index], decide(bodies.alone(index))
        decisions.closed[index], decisions.decided[index], decisions.margin[index] = (
            decision.closed,
            decision.decided,
            decision.margin,
        )
        decisions.twist[index] = decision.twist
        decisions.normal_force[index, present], decisions.tangential[index, present] = (
            decision.normal_force,
            decision.tangential,
        )
    return decisions


def _decide_easy(bodies: WrenchSets, decisions: Decisions) -> None:
    """Write down all that is proven by one run of the simplex method, in coordinates where the discs' matrix is a
    rotation: a balance of one newton at every contact and whatever else, or a twist."""
    columns = WrenchColumns.of(bodies)
    sizes, axes = columns.principal_axes()
    well_conditioned = np.flatnonzero(sizes[:, 0] > EVEN**2 * sizes[:, 5])
    if not len(well_conditioned):
        return
    if len(well_conditioned) < len(sizes):
        bodies, columns, sizes, axes = (
            bodies.take(well_conditioned),
            columns.take(well_conditioned),
            sizes[well_conditioned],
            axes[well_conditioned],
        )
    whitening = np.ascontiguousarray(np.moveaxis(axes / np.sqrt(sizes)[:, None], 0, -1))
    white, present = columns.along(whitening), bodies.present.T
    weights, tangentials, twists = weights_or_twist(white, -white.discs[:, 0].sum(0))
    normal_force = np.where(present, 1 + weights, 0)
    total, smooth = normal_force.sum(0), np.any(columns.discs[:, 1:] != 0, (1, 2))
    normal_force, tangentials = normal_force / total, np.where(smooth[:, None], tangentials, 0) / total
    residual = white.exerted(normal_force, tangentials)
    inside = normal_force - np.sqrt(np.einsum("nkl,nkl->nl", tangentials, tangentials))
    room = np.min(np.where(present, inside, np.inf), 0) / np.sqrt(2)
    radius = np.sqrt(sizes[:, 0]) * (room - np.linalg.norm(residual, axis=0)) - bodies.slack
    margin = CAUTIOUS * radius / (1 + np.sqrt(present.sum(0)) * room)
    plain = np.einsum("jml,ml->jl", whitening, twists)
    plain /= np.maximum(np.linalg.norm(plain, axis=0), np.finfo(float).tiny)
    powers = np.where(present, columns.supports(plain)[0], -np.inf).max(0)
    has_twist: np.ndarray = np.any(twists != 0, 0)
    balanced, opened = ~has_twist & (radius > 0), has_twist & (powers <= bodies.slack)
    decisions.closed[well_conditioned], decisions.decided[well_conditioned] = balanced, balanced | opened
    decisions.margin[well_conditioned] = np.where(balanced, margin, np.where(opened, np.minimum(powers, 0), 0))
    decisions.twist[well_conditioned[opened]] = plain.T[opened]
    decisions.normal_force[well_conditioned[balanced]] = normal_force.T[balanced]
    decisions.tangential[well_conditioned[balanced]] = np.moveaxis(tangentials, -1, 0)[balanced]


def weights_or_twist(white: WrenchColumns, right: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Find weights ``(n, L)`` and tangential forces ``(n, 3, L)`` whose wrenches sum to ``right`` (6, L), or twists.

    The twists ``(6, L)`` work along ``right`` and no contact works along them, as far as the search has come.
    """
    all_bases, twists = SimplexBases.artificial(right, 1.0), np.zeros(right.shape)
    tangentials = np.zeros((6, 3, right.shape[1]))
    tolerance = BALANCED * np.linalg.norm(right, axis=0)
    remaining = np.flatnonzero(all_bases.left_over() > tolerance)
    bases, wrenches, remaining_tangentials = (
        all_bases.take(remaining),
        white.take(remaining),
        tangentials[..., remaining],
    )
    ahead = np.full(len(remaining), AHEAD)
    for _ in range(PIVOTS if len(remaining) else 0):
        programs, directions = np.arange(len(remaining)), bases.multipliers()
        values, across = wrenches.supports(directions)
        best = np.argmax(values, 0)
        works = values[best, programs] > UNMOVED * np.linalg.norm(directions, axis=0)
        twists[:, remaining[~works]] = directions[:, ~works]
        tangential = across[best, :, programs].T
        position = bases.enter(wrenches.of_contact(best, tangential), -ahead, best)
        moved = position >= 0
        remaining_tangentials[position[moved], :, programs[moved]] = tangential.T[moved]
        # Wrenches that balance each other gain without end by what they are to be ahead.
        ahead = np.where(moved, ahead, LESS * ahead)
        bases.costs[:] = np.where(moved | (bases.columns < 0), bases.costs, -ahead)
        is_unfinished = works & (bases.left_over() > tolerance[remaining])
        if not is_unfinished.all():
            unfinished, finished = np.flatnonzero(is_unfinished), np.flatnonzero(~is_unfinished)
            all_bases.put(remaining[finished], bases.take(finished))
            tangentials[..., remaining[finished]] = remaining_tangentials[..., finished]
            if not len(unfinished):
                break
            remaining, bases, wrenches, remaining_tangentials = (
                remaining[unfinished],
                bases.take(unfinished),
                wrenches.take(unfinished),
                remaining_tangentials[..., unfinished],
            )
            ahead = ahead[unfinished]
    return *all_bases.by_contact(tangentials, len(white.discs)), twists


def decide(body: WrenchSet) -> Decision:
    """Decide the force closure of one grasp."""
    count = len(body.centres)
    if not count:
        return _open(np.eye(6)[0], body, True)
    generators = np.concatenate([body.centres.T, *body.spans], 1)
    axes, sizes, _ = np.linalg.svd(generators)
    if len(sizes) < 6 or sizes[5] <= body.rounding * sizes[0]:
        return _open(axes[:, 5], body, True)
    return _separate_or_balance(body, axes / sizes)


class _InSight(NamedTuple):
    """Wrenches of unit normal force that the search has met, and whose they are."""

    points: np.ndarray
    owner: np.ndarray
    tangential: np.ndarray


def _separate_or_balance(body: WrenchSet, whitening: np.ndarray) -> Decision:
    """Search a growing set of the contacts' wrenches for a twist that separates all of them, or for a balance.

    The search, but not the proof, is in coordinates where the discs' matrix is a rotation: contacts almost on a line
    keep their digits.
    """
    white = replace(body, centres=body.centres @ whitening, spans=np.einsum("jm,njk->nmk", whitening, body.spans))
    sight = _first_wrenches(white)
    for _ in range(ROUNDS):
        twist, weights = _least_of_hull(sight.points)
        if weights is not None:
            twist, weights = _towards(sight.points, -white.centres.sum(0))
        if weights is not None:
            return _balance(body, sight, weights, whitening) or _undecided(body)
        for candidate in (twist, _without_idle(white, twist)):
            plain = whitening @ candidate
            plain /= np.linalg.norm(plain)
            if body.supports(plain[None])[0].max() <= body.slack:
                return _open(plain, body, True)
        values, tangential = (array[0] for array in white.supports(twist[None]))
        working = np.flatnonzero(values > 0)
        reached = white.centres[working] + np.einsum("njk,nk->nj", white.spans[working], tangential[working])
        sight = _InSight(*(np.concatenate(pair) for pair in zip(sight, (reached, working, tangential[working]))))
    return _undecided(body)


def _first_wrenches(body: WrenchSet) -> _InSight:
    """Return each disc's wrenches at both ends of every column of its span."""
    count = len(body.centres)
    tangential = np.tile(np.concatenate([np.eye(3), -np.eye(3)]), (count, 1))
    owner = np.repeat(np.arange(count), 6)
    return _InSight(body.centres[owner] + np.einsum("njk,nk->nj", body.spans[owner], tangential), owner, tangential)


def _without_idle(body: WrenchSet, twist: np.ndarray) -> np.ndarray:
    """Remove from a twist its components along the wrenches of idle contacts, whose power should be zero.

    Where two contacts hold each other, a twist that opens the grasp turns about the line between them: no power
    is allowed, either way, and a search meets this but for digits that it loses where they barely hold.
    """
    along, across = body.centres @ twist, np.einsum("njk,j->nk", body.spans, twist)
    idle = np.abs(along) + np.linalg.norm(across, axis=1) <= IDLE * body.size
    axes, sizes, _ = np.linalg.svd(np.concatenate([body.centres[idle].T, *body.spans[idle]], 1), full_matrices=False)
    axes = axes[:, sizes > IDLE * np.max(sizes, initial=0)]
    remainder = twist - axes @ (axes.T @ twist)
    size = np.linalg.norm(remainder)
    return remainder / size if size > IDLE else twist


def _least_of_hull(points: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
    """Return a unit twist that all points work against, or weights that balance them if their hull holds 0."""
    from scipy.optimize import nnls

    weights, _ = nnls(np.vstack([points.T, np.ones(len(points))]), np.eye(7)[6])
    nearest = weights @ points / weights.sum()
    size = np.linalg.norm(nearest)
    if size > SEPARATE * np.linalg.norm(points, axis=1).max():
        return -nearest / size, None
    return np.zeros(6), weights


def _towards(points: np.ndarray, target: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
    """Return weights of points that sum to the target, or a unit twist along which it works and no point does."""
    from scipy.optimize import nnls

    weights, _ = nnls(points.T, target)
    if weights.sum() > MAKE_BELIEVE * np.linalg.norm(target):
        # If the points span no more than a hyperplane but for rounding, large weights make up any target.
        weight_costs = np.full((1, len(points)), PRICE)
        weights, _ = nnls(np.vstack([points.T, weight_costs]), np.append(target, 0))
    residual = target - weights @ points
    size = np.linalg.norm(residual)
    if size > BALANCED * (np.linalg.norm(target) + weights @ np.linalg.norm(points, axis=1)):
        return residual / size, None
    return np.zeros(6), weights


def _balance(body: WrenchSet, sight: _InSight, weights: np.ndarray, whitening: np.ndarray) -> Decision | None:
    """Return one newton at every contact and the forces that balance it, or None if not proven strictly inside.

    The forces (normal, tangential) of all contacts may move by ``room`` each and stay inside. In white coordinates such
    moves make up for any wrench of their own length, and lengths are at most those in plain ones over the least
    singular value of the discs' matrix.
    """
    count = len(body.centres)
    normal_force = 1 + np.bincount(sight.owner, weights, count)
    tangential = np.zeros((count, 3))
    np.add.at(tangential, sight.owner, weights[:, None] * sight.tangential)
    smooth = np.any(body.spans != 0, (1, 2))
    total = normal_force.sum()
    normal_force, tangential = normal_force / total, np.where(smooth[:, None], tangential, 0) / total
    residual = (normal_force @ body.centres + np.einsum("njk,nk->j", body.spans, tangential)) @ whitening
    room = np.min(normal_force - np.linalg.norm(tangential, axis=1)) / np.sqrt(2)
    least_size = 1 / np.linalg.norm(whitening, axis=0).max()
    radius = least_size * (room - np.linalg.norm(residual)) - body.slack
    if radius <= 0:
        return None
    return Decision(True, True, radius / (1 + np.sqrt(count) * room), np.zeros(6), normal_force, tangential)


def _open(twist: np.ndarray, body: WrenchSet, decided: bool) -> Decision:
    values, _ = body.supports(twist[None])
    count = len(body.centres)
    margin = min(float(values.max(initial=-np.inf)), 0.0) if count else 0.0
    return Decision(False, decided, margin, twist, np.zeros(count), np.zeros((count, 3)))


def _undecided(body: WrenchSet) -> Decision:
    return _open(np.zeros(6), body, False)
