"""Public functions that answer the same question, as inverses, duals or special cases, agree on all kinds of problems.

Each pair is computed by different code, so that neither can be wrong in silence. All problems have the same shape,
absent contacts included, and so one program each.
"""

from functools import cache
from typing import NamedTuple

import jax
import numpy as np
import pytest

import jaxgrasp
from jaxgrasp import Grasp, Limits, Verdict
from jaxgrasp.testing import problems as P

KINDS = (
    "ordinary",
    "near_line",
    "near_collinear",
    "near_plane",
    "coincident_some",
    "tiny_friction",
    "huge_friction",
    "mixed_friction",
    "some_zero_squeeze",
    "far_frame",
    "infeasible",
)
SIZES, PLACES, PER_KIND = (2, 3, 4, 7, 10), 10, 8
"""Contacts of the grasps, those that their arrays hold, and grasps of each size."""
WRONG = 1e-6
"""The relative accuracy that ``least_squeeze`` promises."""
BESIDE = 1e-5
"""How far from an answer the other function is asked, relative to it: ``least_friction`` may be off by 1e-6."""


class Pairs(NamedTuple):
    """Grasps whose contacts stand first, and are followed by absent ones, and the wrenches that they are to exert."""

    grasp: Grasp
    wrench: np.ndarray

    def with_friction(self, factor: np.ndarray) -> Grasp:
        g = self.grasp
        return Grasp(g.points, g.normals, g.friction * factor[:, None], g.squeeze, g.present)


def problems_of(kind: str, n: int, count: int, seed: int) -> P.Problems:
    """Return feasible problems of a kind of ``jaxgrasp.testing.problems``, or of a kind of this file."""
    if kind in P.KINDS:
        return P.problems(kind, n, count, seed)
    made = P.problems("ordinary", n, count, seed)
    rng = np.random.default_rng([seed, n, KINDS.index(kind)])
    points, friction = made.points, made.friction
    if kind in ("near_line", "near_plane"):
        # Spread across of 3e-4 to 3e-2 of that along: 0.015 to 1.5 mm of 50 mm.
        frame = np.linalg.qr(rng.normal(size=(count, 3, 3)))[0]
        thin = np.exp(rng.uniform(np.log(3e-4), np.log(3e-2), count))[:, None, None]
        flat = [0, 1, 1] if kind == "near_line" else [0, 0, 1]
        local = rng.uniform(-1, 1, (count, n, 3)) * np.where(flat, thin, 1)
        points = points.mean(1, keepdims=True) + 0.05 * local @ frame
    else:
        low, high = {"tiny_friction": (1e-5, 1e-3), "huge_friction": (30, 1e3), "mixed_friction": (1e-3, 10)}[kind]
        friction = np.exp(rng.uniform(np.log(low), np.log(high), friction.shape))
    contacts = P.Contacts(points, made.normals, friction, made.squeeze)
    wrench = P.exact_wrench(points, P.allowed_forces(rng, contacts, made.squeeze))
    return P.Problems(kind, *contacts, wrench, True)


@cache
def pairs_of(kind: str, seed: int = 3) -> Pairs:
    """Return grasps of every size."""
    parts = [problems_of(kind, n, PER_KIND, seed) for n in SIZES if n >= P.LEAST_CONTACTS.get(kind, 1)]
    rows = []
    for name in ("points", "normals", "friction", "squeeze"):
        arrays = [getattr(part, name) for part in parts]
        rows.append(
            np.concatenate([np.pad(x, [(0, 0), (0, PLACES - x.shape[1])] + [(0, 0)] * (x.ndim - 2)) for x in arrays])
        )
    sizes = np.repeat([part.points.shape[1] for part in parts], PER_KIND)
    present = (np.arange(PLACES) < sizes[:, None]).astype(float)
    return Pairs(Grasp(*rows, present), np.concatenate([part.wrench for part in parts]))


@cache
def least_totals(kind: str, seed: int = 3) -> np.ndarray:
    pairs = pairs_of(kind, seed)
    return np.asarray(jaxgrasp.least_squeeze(pairs.grasp, pairs.wrench, "uniform"))


@cache
def optimum(kind: str) -> jaxgrasp.Solution:
    pairs = pairs_of(kind)
    return jax.device_get(jaxgrasp.constrained_optimum(pairs.grasp, pairs.wrench, "uniform"))


def largest_rate(grasp: Grasp, twist: np.ndarray) -> np.ndarray:
    """Return the most work ``(B,)`` along a twist by a unit of normal force and its friction, by definition."""
    velocity = twist[:, None, :3] + np.cross(twist[:, None, 3:], grasp.points)
    along = (velocity * grasp.normals).sum(-1)
    across = np.linalg.norm(velocity - along[..., None] * grasp.normals, axis=-1)
    return np.where(np.asarray(grasp.present) > 0.5, along + grasp.friction * across, 0).max(-1)


def check_totals(kind: str, seed: int) -> np.ndarray:
    """Check least totals against the largest wrench of a total of one; return those of wrenches in reach."""
    pairs, total = pairs_of(kind, seed), least_totals(kind, seed)
    inverse = jaxgrasp.quality.largest_wrench(pairs.grasp, pairs.wrench, "l1", tol=WRONG / 4)
    answered = ~np.isnan(total)
    with np.errstate(divide="ignore"):
        enough, needed = 1 / inverse.lower, 1 / inverse.upper
    assert (total >= needed * (1 - WRONG))[answered].all()
    assert (total <= enough * (1 + WRONG))[answered].all()
    # The same by arithmetic that nobody else does: the twist's proof that less is too little.
    rate, work = largest_rate(pairs.grasp, inverse.twist), (pairs.wrench * inverse.twist).sum(-1)
    finite = np.isfinite(total)
    assert (np.where(finite, total, 0) * rate >= work * (1 - WRONG))[finite].all()
    return total[np.isfinite(enough)]


@pytest.mark.parametrize("kind", KINDS)
def test_the_least_total_is_one_over_the_largest_wrench(kind):
    held = check_totals(kind, 3)
    assert np.isfinite(held).mean() > 0.97 if len(held) else kind == "infeasible"


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4, 10))
@pytest.mark.parametrize("kind", ("near_line", "near_collinear", "mixed_friction"))
def test_the_least_total_is_one_over_the_largest_wrench_in_long_families(kind, seed):
    assert np.isfinite(check_totals(kind, seed)).mean() > 0.97


@pytest.mark.parametrize("kind", KINDS)
def test_a_least_total_exists_where_the_optimum_does_and_is_no_more_than_its(kind):
    total, best = least_totals(kind), optimum(kind)
    held = best.verdict <= Verdict.OPTIMAL
    np.testing.assert_array_equal(np.isposinf(total), ~held)
    normal_force = (best.forces * pairs_of(kind).grasp.normals).sum((1, 2))
    answered = np.isfinite(total)
    assert (normal_force >= total * (1 - WRONG))[answered].all()


@pytest.mark.slow
@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind != "infeasible"])
def test_with_the_least_total_the_least_friction_is_all_there_is_and_gives_the_total_back(kind):
    pairs, total = pairs_of(kind), least_totals(kind)
    finite = np.isfinite(total)
    # Where no friction replaces a normal force, a total that is too small by its rounding takes any friction.
    allowed = np.where(finite, total * (1 + WRONG), 1)
    factor = np.asarray(jaxgrasp.least_friction(pairs.grasp, pairs.wrench, "uniform", total=allowed))
    assert (factor <= 1 + BESIDE)[finite].all()
    # Where less does, as where no friction is used, the total is enough for it too.
    some = finite & (factor > 0)
    back = jaxgrasp.least_squeeze(
        pairs.with_friction(np.where(some, factor * (1 + BESIDE), 1)), pairs.wrench, "uniform"
    )
    answered = some & ~np.isnan(back)
    assert answered.sum() >= 0.9 * some.sum()
    assert (back <= allowed * (1 + BESIDE))[answered].all()


@pytest.mark.slow
@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind != "infeasible"])
def test_a_little_more_than_the_least_friction_holds_by_the_total_and_a_little_less_does_not(kind):
    pairs = pairs_of(kind)
    # Contacts without squeeze count for nothing in the total that is allowed, and may press.
    allowed = np.asarray(pairs.grasp.squeeze).sum(1)
    factor = np.asarray(jaxgrasp.least_friction(pairs.grasp, pairs.wrench, "uniform", total=allowed))
    some = (factor > 0) & np.isfinite(factor)
    assert some.sum() > 0.3 * len(some)
    reserve = np.asarray(jaxgrasp.sensitivity.friction_reserve(pairs.grasp, pairs.wrench).reserve)
    assert ((reserve > 0) == np.isfinite(factor))[
        pairs.grasp.squeeze.min(1, where=pairs.grasp.present > 0.5, initial=1) > 0
    ].all()
    for share, holds in ((1 + BESIDE, True), (1 - BESIDE, False)):
        grasp = pairs.with_friction(np.where(some, factor * share, 1))
        needed = np.asarray(jaxgrasp.least_squeeze(grasp, pairs.wrench, "uniform"))
        verdict = np.asarray(jaxgrasp.constrained_optimum(grasp, pairs.wrench, "uniform").verdict)
        if holds:
            assert (verdict <= Verdict.OPTIMAL)[some].all()
            assert (needed <= allowed * (1 + BESIDE))[some & ~np.isnan(needed)].all()
        else:
            assert (needed >= allowed)[some & ~np.isnan(needed)].all()


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_wrenches_within_the_margin_are_held_and_those_beyond_are_not(kind):
    pairs = pairs_of(kind)
    rng = np.random.default_rng(5)
    direction = rng.normal(size=pairs.wrench.shape) * np.abs(pairs.wrench).mean(0)
    margin = np.asarray(jaxgrasp.wrench_margin(pairs.grasp, pairs.wrench, direction, "uniform"))
    held = optimum(kind).verdict <= Verdict.OPTIMAL
    # A wrench that is exerted has a margin; of two contacts none along torques about their line.
    assert (margin[held] >= -BESIDE).all()
    some = np.isfinite(margin) & (np.abs(margin) > 0.01)
    task = jaxgrasp.quality.task_margin(pairs.grasp, direction[:, None], pairs.wrench, "uniform")
    np.testing.assert_allclose(task.margin, margin, rtol=1e-6, atol=1e-9)
    for share, within in ((1 - BESIDE, True), (1 + BESIDE, False)):
        beside = np.where(some & held, margin * share, 0)[:, None] * direction
        verdict = np.asarray(jaxgrasp.constrained_optimum(pairs.grasp, pairs.wrench + beside, "uniform").verdict)
        residuals = np.asarray(jaxgrasp.reachable_wrench(pairs.grasp, pairs.wrench + beside, "uniform").distance)
        answers = (verdict <= Verdict.OPTIMAL) == within, (residuals == 0) == within
        assert all(answer[some & held].all() for answer in answers)


@pytest.mark.slow
@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind != "infeasible"])
def test_the_margin_of_no_load_with_limited_normal_forces_is_the_largest_wrench(kind):
    pairs = pairs_of(kind)
    size = np.linalg.norm(pairs.wrench, axis=1, keepdims=True)
    limits = Limits(normal_max=np.ones_like(pairs.grasp.friction))
    margin = np.asarray(
        jaxgrasp.wrench_margin(pairs.grasp, 0 * pairs.wrench, pairs.wrench / size, "uniform", limits=limits)
    )
    largest = jaxgrasp.quality.largest_wrench(pairs.grasp, pairs.wrench / size, "linf")
    answered = ~np.isnan(margin)
    assert answered.mean() > (0.5 if kind == "near_collinear" else 0.9)
    assert (margin >= largest.lower * (1 - WRONG) - WRONG)[answered].all()
    assert (margin <= largest.upper * (1 + WRONG) + WRONG)[answered].all()


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["ordinary", "near_line", "near_plane", "coincident_some", "far_frame"])
def test_closed_grasps_have_a_ball_and_every_wrench_and_open_ones_have_neither(kind):
    pairs = pairs_of(kind)
    closure = jaxgrasp.quality.force_closure(pairs.grasp)
    ball = jaxgrasp.quality.ferrari_canny(pairs.grasp)
    opposite = np.asarray(jaxgrasp.least_squeeze(pairs.grasp, -pairs.wrench, "uniform"))
    assert 0.05 < closure.closed.mean() < 0.95
    assert ((ball.upper > 0) & (opposite < np.inf) | np.isnan(opposite))[closure.closed].all()
    assert (closure.margin <= ball.upper * (1 + WRONG))[closure.closed].all()
    assert (ball.lower <= 0)[closure.decided & ~closure.closed].all()
    # A twist along which no contact can push: the optimum cannot exert what works along it.
    open_ones = closure.decided & ~closure.closed
    along = np.where(open_ones[:, None], closure.twist, pairs.wrench)
    verdict = np.asarray(jaxgrasp.constrained_optimum(pairs.grasp, along, "uniform").verdict)
    assert (verdict > Verdict.OPTIMAL)[open_ones].all()


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["ordinary", "near_line", "near_plane", "coincident_some", "mixed_friction"])
def test_forces_exist_in_cones_narrower_by_the_largest_margin_and_in_no_narrower_ones(kind):
    pairs = pairs_of(kind)
    g = pairs.grasp
    limits = Limits(normal_max=5 * g.squeeze + 1)
    best = jaxgrasp.best_forces(g, pairs.wrench, "largest_margin", limits=limits)
    held = np.asarray(best.verdict) == Verdict.OPTIMAL
    limited = jaxgrasp.constrained_optimum(g, pairs.wrench, "uniform", limits=limits)
    feasible = np.asarray(limited.verdict) <= Verdict.OPTIMAL
    # Two contacts in one point (rank 3) exert forces through it alone; there the search may stay undecided.
    spread = np.asarray(limited.rank) > 3
    assert held[feasible & spread].mean() >= 0.9
    assert not held[~feasible].any()
    # The forces themselves: they exert the wrench, within their limits and inside the narrower cones.
    forces = np.asarray(best.forces)[held]
    exerted = np.concatenate([forces.sum(1), np.cross(g.points[held], forces).sum(1)], -1)
    residual = exerted - pairs.wrench[held]
    assert (np.abs(residual).max(-1) <= WRONG * np.linalg.norm(pairs.wrench[held], axis=-1)).all()
    normal = np.sum(forces * g.normals[held], -1)
    tangential = np.linalg.norm(forces - normal[..., None] * g.normals[held], axis=-1)
    angle = np.arctan(g.friction)
    margin = np.where((g.present[held] > 0) & (normal > 0), angle[held] - np.arctan2(tangential, normal), np.inf)
    assert (margin.min(-1) >= np.asarray(best.value)[held] - 1e-9).all()
    assert (normal <= limits.normal_max[held] * (1 + WRONG)).all()
    # By the optimum: the multiple of the wrench may fall from several to none within some 1e-6 rad before the edge,
    # where forces exist to a residual of 1e-8 alone; 1e-4 before it the optimum finds them.
    for edge, holds in ((np.asarray(best.value) - 1e-4, True), (np.asarray(best.bound) + 1e-6, False)):
        left = np.where(held, edge, 0)[:, None]
        is_used_up = angle <= left
        friction = np.where(is_used_up, 0, np.tan(np.maximum(angle - left, 0)))
        narrower = Grasp(g.points, g.normals, friction, g.squeeze, np.where(is_used_up, 0, g.present))
        verdict = np.asarray(jaxgrasp.constrained_optimum(narrower, pairs.wrench, "uniform", limits=limits).verdict)
        assert ((verdict <= Verdict.OPTIMAL) == holds)[held].all()
