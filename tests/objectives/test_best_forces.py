"""Forces by an objective: known answers, an independent oracle, bounds, invariance, derivatives, bad input."""

from collections.abc import Callable
from functools import cache, partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxgrasp
from jaxgrasp import OBJECTIVES, BestForces, Grasp, Limits, Verdict, best_forces, friction_margin
from jaxgrasp.testing import limited_reference
from jaxgrasp.testing.limited_problems import LimitedProblems, limited_problems
from tests.turns import in_turns

COUNT, N, JOINTS = 24, 4, 5
KINDS = ("ordinary", "low_friction", "zero_friction", "some_zero_squeeze", "coincident_some", "far_frame", "combined")
QUICK = ("ordinary", "combined")
each_kind = pytest.mark.parametrize("kind", in_turns(KINDS, QUICK))


def made_of(kind: str, *, limited: bool, seed: int = 2) -> LimitedProblems:
    """Return problems with limits, or with limits that never bind: the same compiled code serves both."""
    made = limited_problems(kind, N, COUNT, seed, soft=True, bounded=True, joints=JOINTS)
    if limited:
        return made
    none = {name: np.full_like(getattr(made, name), np.inf) for name in ("normal_max", "torque_max")}
    return made._replace(normal_min=np.zeros_like(made.normal_min), **none)


def all_there(made: LimitedProblems) -> Grasp:
    """Return the grasps with a mask of ones, so that they run the code compiled for grasps with absent contacts."""
    grasp = made.grasp
    return Grasp(
        grasp.points, grasp.normals, grasp.friction, grasp.squeeze, np.ones_like(grasp.friction), torsion=grasp.torsion
    )


def solve(made: LimitedProblems, objective: str) -> BestForces:
    return jax.device_get(best_forces(all_there(made), made.problem.wrench, objective, limits=made.limits))


@cache
def solved(kind: str, limited: bool, objective: str) -> BestForces:
    """Solve problems once for the several laws about the same forces."""
    return solve(made_of(kind, limited=limited), objective)


def achieved(made: LimitedProblems, objective: str, forces: np.ndarray, moments: np.ndarray) -> np.ndarray:
    """Compute an objective of the given forces from its definition."""
    g = made.grasp
    if objective == "largest_margin":
        margins = np.asarray(friction_margin(g, forces, moments))
        # Where no contact with friction is loaded, no more than the widest friction angle.
        return np.minimum(np.where(g.friction > 0, margins, np.inf).min(-1), np.arctan(g.friction).max(-1))
    lever = np.where(g.friction > 0, g.torsion / np.where(g.friction > 0, g.friction, 1), 0)
    spin = np.where(lever > 0, moments / np.where(lever > 0, lever, 1), 0)
    size = np.sqrt((forces**2).sum(-1) + spin**2)
    if objective == "least_norm":
        return np.sqrt((size**2).sum(-1))
    if objective == "least_maximal_force":
        return size.max(-1)
    pushes = np.concatenate([forces, moments[..., None]], -1)
    return np.linalg.norm(np.einsum("bnc,bncj->bj", pushes, made.torque_map), axis=-1)


def padded_pinch(wrench: np.ndarray, *, least: float, most: float, torsion: float = 0.0) -> tuple:
    """Return two opposed contacts among absent ones, in the shape that the other tests compile: grasps and limits."""
    points = np.array([[-0.03, 0, 0], [0.03, 0, 0], [0, 0.01, 0], [0, 0, 0]])
    normals = np.array([[1.0, 0, 0], [-1, 0, 0], [0, 1, 0], [0, 1, 0]])
    count = len(wrench)

    def repeat(x) -> np.ndarray:
        return np.broadcast_to(np.asarray(x, float), (count, *np.shape(x)))

    present = repeat([1.0, 1, 0, 0])
    grasp = Grasp(
        repeat(points), repeat(normals), repeat([0.5] * 4), 0 * present, present, torsion=repeat([torsion] * 4)
    )
    limits = Limits(
        normal_min=repeat([least] * 4),
        normal_max=repeat([most] * 4),
        torque_map=repeat(np.zeros((4, 4, JOINTS))),
        torque_max=repeat(np.full(JOINTS, np.inf)),
    )
    return grasp, wrench, limits


def values_and_pull(data: tuple, objective: str) -> tuple[jax.Array, Callable]:
    """Compute values of (grasp, wrench, limits) and the pullback to all of it: one program for all tests."""
    return jax.vjp(lambda data: best_forces(data[0], data[1], objective, limits=data[2]).value, data)


@pytest.mark.slow
def test_two_antipodal_contacts_have_known_answers():
    load = np.zeros((COUNT, 6))
    load[:, 2] = 2
    grasp, load, limits = padded_pinch(load, least=0, most=12)
    mu = np.geomspace(0.2, 1.5, COUNT)
    weaker = limits.normal_max.copy()
    weaker[:, 0] = 10
    grasp = eqx.tree_at(lambda g: g.friction, grasp, np.repeat(mu[:, None], 4, 1))
    limits = eqx.tree_at(lambda x: x.normal_max, limits, weaker)
    solutions = {name: jax.device_get(best_forces(grasp, load, name, limits=limits)) for name in OBJECTIVES[:3]}
    force = np.sqrt(1 + 1 / mu**2)
    assert np.allclose(solutions["least_maximal_force"].value, force, rtol=1e-8)
    assert np.allclose(solutions["least_norm"].value, np.sqrt(2) * force, rtol=1e-8)
    # The weaker finger presses with what it may, and so must the other; each carries half of the load.
    assert np.allclose(solutions["largest_margin"].value, np.arctan(mu) - np.arctan(1 / 10), atol=3e-7)


@pytest.mark.slow
def test_degenerate_problems_have_their_answers():
    # Nothing to hold; one finger that pushes; two without friction, that push unalike; no contact.
    loads = np.zeros((COUNT, 6))
    loads[1, 0], loads[2, 0], loads[3, 0] = 5, 3, 1
    grasp, loads, limits = padded_pinch(loads, least=0, most=20)
    friction, present = grasp.friction.copy(), grasp.present.copy()
    friction[2], present[1, 1], present[3] = 0, 0, 0
    grasp = eqx.tree_at(lambda g: (g.friction, g.present), grasp, (friction, present))
    angle = np.arctan(0.5)
    expected_by_objective = {
        "least_norm": (0, 5, 3),
        "least_maximal_force": (0, 5, 3),
        "largest_margin": (angle, angle, 0),
    }
    for objective, values in expected_by_objective.items():
        solution = jax.device_get(best_forces(grasp, loads, objective, limits=limits))
        assert solution.verdict[:4].tolist() == [Verdict.OPTIMAL] * 3 + [Verdict.NO_CONTACTS], objective
        assert np.allclose(solution.value[:3], values, atol=3e-7), objective
        assert np.isfinite(solution.forces).all() and np.allclose(solution.forces.sum(1)[:3], loads[:3, :3], atol=1e-6)


@pytest.mark.parametrize(("least", "most"), [(0, 2.0), (1.9, 2.0), (2.0, 2.0)])
def test_the_margin_of_a_pinch_is_known_however_tight_its_limits_are(least, most):
    wrench = np.zeros((COUNT, 6))
    wrench[:, 1:3] = np.random.default_rng(0).uniform(-0.6, 0.6, (COUNT, 2))
    grasp, wrench, limits = padded_pinch(wrench, least=least, most=most)
    solution = jax.device_get(best_forces(grasp, wrench, "largest_margin", limits=limits))
    margin = np.arctan(0.5) - np.arctan(np.linalg.norm(wrench[:, 1:3], axis=1) / 4)
    assert np.allclose(solution.value, margin, atol=1e-6)
    assert (solution.bound >= margin - 1e-9).all()
    assert (solution.verdict == Verdict.OPTIMAL).all() and (solution.bound <= margin + 1e-5).all()


@pytest.mark.parametrize("kind", in_turns(("ordinary", "near_collinear", "limit_99"), ("ordinary",)))
def test_the_largest_margin_is_found_where_nothing_is_exerted_beyond_it(kind):
    """Without other limits: narrower cones exert more than the wrench up to an angle, and beyond it nothing."""
    made = made_of(kind, limited=True)
    loose = made._replace(
        normal_min=np.zeros_like(made.normal_min),
        normal_max=np.full_like(made.normal_max, 20.0),
        torque_max=np.full_like(made.torque_max, np.inf),
    )
    solution = solve(loose, "largest_margin")
    some = solution.verdict != Verdict.INFEASIBLE
    assert some.sum() > COUNT / 2
    assert (solution.verdict == Verdict.OPTIMAL)[some].mean() >= (1 if kind == "ordinary" else 0.9)
    solved = solution.verdict == Verdict.OPTIMAL
    assert (solution.bound[solved] - solution.value[solved]).max() < 3e-6


def test_a_padded_pinch_of_soft_fingers_is_solved():
    wrench = np.zeros((COUNT, 6))
    wrench[:, 3] = np.linspace(0.001, 0.05, COUNT)
    grasp, wrench, limits = padded_pinch(wrench, least=0, most=5, torsion=0.01)
    solution = jax.device_get(best_forces(grasp, wrench, "least_maximal_force", limits=limits))
    # Each turns half of it, at its limit of 0.01 m times its press.
    press = wrench[:, 3] / 0.02
    assert (solution.verdict == Verdict.OPTIMAL).all()
    assert np.allclose(solution.value, press * np.sqrt(1 + 0.5**2), rtol=1e-7)


@pytest.mark.parametrize("objective", OBJECTIVES[1:])
def test_an_absent_contact_has_no_derivative(objective):
    grasp, wrench, limits = padded_pinch(np.tile([0, 0, 0.5, 0, 0, 0.0], (COUNT, 1)), least=0, most=9)
    turned = np.zeros((COUNT, 4, 4, JOINTS))
    turned[:, :, 2, 0] = 0.04
    limits = eqx.tree_at(lambda x: x.torque_map, limits, turned)

    values, pull = values_and_pull(jax.tree.map(jnp.asarray, (grasp, wrench, limits)), objective)
    moves = pull(jnp.ones_like(values))[0][0]
    assert not np.asarray(moves.friction)[:, 2:].any() and not np.asarray(moves.points)[:, 2:].any()
    assert all(np.isfinite(x).all() for x in jax.tree.leaves(moves))


@pytest.mark.repeats
@pytest.mark.parametrize("limited", [False, True])
@each_kind
def test_forces_are_allowed_and_worth_what_is_said(kind, limited):
    made = made_of(kind, limited=limited)
    g, w = made.grasp, made.problem.wrench
    for objective in OBJECTIVES:
        solution = solved(kind, limited, objective)
        good = solution.verdict == Verdict.OPTIMAL
        # Presses of up to 1e3 loads, in such units, are more than the proof of a margin can take.
        coarse = objective == "largest_margin" and kind == "combined" and not limited
        assert good.mean() > (0.5 if coarse else 0.9), objective
        torque = np.cross(g.points, solution.forces).sum(1) + (solution.moments[..., None] * g.normals).sum(1)
        wrench = np.concatenate([solution.forces.sum(1), torque], -1)
        scale = np.abs(solution.forces).max((1, 2)) * (1 + np.abs(g.points).max((1, 2))) + np.abs(w).max(1)
        assert (np.abs(wrench - w).max(1) < 1e-7 * scale)[good].all(), objective
        press = (solution.forces * g.normals).sum(-1)
        slack = 1e-6 * np.abs(solution.forces).max((1, 2))[:, None] + 1e-6 * np.linalg.norm(w[:, :3], axis=-1)[:, None]
        lean = np.linalg.norm(solution.forces - press[..., None] * g.normals, axis=-1)
        assert (lean <= g.friction * press + slack)[good].all(), objective
        if limited:
            assert (press >= made.normal_min - slack)[good].all(), objective
            assert (press <= made.normal_max + slack)[good].all()
            pushes = np.concatenate([solution.forces, solution.moments[..., None]], -1)
            size = np.abs(made.torque_map).sum((1, 2)) * np.abs(pushes).max((1, 2))[:, None]
            turned = np.abs(np.einsum("bnc,bncj->bj", pushes, made.torque_map))
            assert (turned <= made.torque_max + 1e-6 * size)[good].all()
        value = achieved(made, objective, solution.forces, solution.moments)
        if objective == "largest_margin":
            assert (value >= solution.value - 1e-9).all() and (solution.bound >= solution.value).all()
            continue
        nothing = 1e-8 * np.linalg.norm(w[:, :3], axis=-1)
        assert (np.abs(value - solution.value) <= 1e-7 * value + nothing)[good].all(), objective
        assert (solution.bound <= solution.value * (1 + 1e-9) + nothing)[good].all(), objective


@pytest.mark.repeats
@pytest.mark.parametrize("limited", [False, True])
@each_kind
def test_no_objective_finds_better_forces_by_another_name(kind, limited):
    made = made_of(kind, limited=limited)
    solutions = {objective: solved(kind, limited, objective) for objective in OBJECTIVES}
    for objective in OBJECTIVES:
        for other_solution in solutions.values():
            is_solved_by_both = (solutions[objective].verdict == Verdict.OPTIMAL) & (
                other_solution.verdict == Verdict.OPTIMAL
            )
            theirs = achieved(made, objective, other_solution.forces, other_solution.moments)
            if objective == "largest_margin":
                # What hardly presses at all, next to others, has any angle.
                assert (solutions[objective].bound >= theirs - 1e-6)[is_solved_by_both].all()
                continue
            nothing = 1e-7 * np.linalg.norm(made.problem.wrench[:, :3], axis=-1)
            assert (solutions[objective].bound <= theirs * (1 + 1e-6) + nothing)[is_solved_by_both].all()


@pytest.mark.repeats
@pytest.mark.parametrize("limited", [False, True])
@each_kind
@pytest.mark.parametrize("objective", ["least_maximal_force", "least_torque"])
def test_values_are_those_of_an_independent_oracle(objective, kind, limited):
    made = made_of(kind, limited=limited)
    solution = solved(kind, limited, objective)
    compared = 0
    for i in range(8):
        theirs = getattr(limited_reference, objective)(made.case(i, np.ones((COUNT, N))), 1e-9)
        if theirs.status != "Solved":
            continue
        compared += 1
        # Where nothing has to be spent both find next to nothing.
        nothing = 1e-7 * np.linalg.norm(made.problem.wrench[i, :3])
        assert abs(solution.value[i] - theirs.objective) <= 1e-6 * theirs.objective + nothing
    assert compared >= 4


@pytest.mark.repeats
@pytest.mark.parametrize("limited", [False, True])
@pytest.mark.parametrize("kind", in_turns([kind for kind in KINDS if kind != "zero_friction"], QUICK))
def test_an_independent_oracle_finds_forces_of_the_margin_and_none_beyond_its_bound(kind, limited):
    made = made_of(kind, limited=limited)
    if limited:
        statuses = solved(kind, limited, "largest_margin")
    else:
        loads = np.linalg.norm(made.problem.wrench[:, :3], axis=-1)
        made = made._replace(normal_max=np.broadcast_to(20 * loads[:, None], (COUNT, N)))
        statuses = solve(made, "largest_margin")
    nothing_here = {"below": [], "beyond": []}
    for i in np.flatnonzero(statuses.verdict == Verdict.OPTIMAL)[:8]:
        case = made.case(i, np.ones((COUNT, N)))
        nothing_here["below"].append(limited_reference.with_margin(case, statuses.value[i] * (1 - 1e-3)))
        nothing_here["beyond"].append(limited_reference.with_margin(case, statuses.bound[i] * (1 + 1e-3)))
    assert len(nothing_here["below"]) >= 4
    # Clarabel may end undecided, but never against the other.
    assert "PrimalInfeasible" not in nothing_here["below"] and nothing_here["below"].count("Solved") >= 4
    assert "Solved" not in nothing_here["beyond"] and nothing_here["beyond"].count("PrimalInfeasible") >= 4


def turned(made: LimitedProblems, rotation: np.ndarray) -> LimitedProblems:
    p = made.problem
    wrench = np.concatenate([p.wrench[:, :3] @ rotation.T, p.wrench[:, 3:] @ rotation.T], -1)
    maps = np.concatenate(
        [np.einsum("xy,bnyj->bnxj", rotation, made.torque_map[:, :, :3]), made.torque_map[:, :, 3:]], 2
    )
    moved = p._replace(points=p.points @ rotation.T, normals=p.normals @ rotation.T, wrench=wrench)
    return made._replace(problem=moved, torque_map=maps)


@pytest.mark.parametrize("objective", OBJECTIVES)
def test_frames_units_and_order_do_not_matter(objective):
    made = made_of("ordinary", limited=True)
    plain = solved("ordinary", True, objective)
    good = plain.verdict == Verdict.OPTIMAL
    rotation, _ = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))
    rotation *= np.linalg.det(rotation)
    other_solution = solve(turned(made, rotation), objective)
    assert np.allclose(other_solution.value[good], plain.value[good], rtol=1e-6, atol=1e-6)
    p, order = made.problem, [2, 0, 3, 1]
    reordered = {name: getattr(made, name)[:, order] for name in ("torsion", "normal_min", "normal_max", "torque_map")}
    swapped = p._replace(**{k: getattr(p, k)[:, order] for k in ("points", "normals", "friction", "squeeze")})
    other_solution = solve(made._replace(problem=swapped, **reordered), objective)
    assert np.allclose(other_solution.value[good], plain.value[good], rtol=1e-6, atol=1e-6)
    louder = p._replace(wrench=100 * p.wrench, squeeze=100 * p.squeeze)
    scaled = {name: 100 * getattr(made, name) for name in ("normal_min", "normal_max", "torque_max")}
    other_solution = solve(made._replace(problem=louder, **scaled), objective)
    factor = 1 if objective == "largest_margin" else 100
    assert np.allclose(other_solution.value[good], factor * plain.value[good], rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("objective", [pytest.param("least_norm", marks=pytest.mark.slow), *OBJECTIVES[1:]])
@pytest.mark.parametrize("limited", [pytest.param(False, marks=pytest.mark.slow), True])
def test_forward_reverse_and_finite_differences_agree(objective, limited):
    made = made_of("ordinary", limited=limited, seed=5)
    limits = jax.tree.map(jnp.asarray, made.limits)
    grasp = jax.tree.map(jnp.asarray, all_there(made))
    data = (grasp, jnp.asarray(made.problem.wrench), limits)
    rng = np.random.default_rng(1)
    # In proportion, so that no bound turns over; normals stay of unit length.
    moved = jax.tree.map(lambda x: jnp.where(jnp.isfinite(x), rng.normal(size=x.shape) * jnp.abs(x), 0), data)
    turned = jnp.cross(jnp.asarray(rng.normal(size=grasp.normals.shape)), grasp.normals)
    moved = eqx.tree_at(lambda d: d[0].normals, moved, turned)

    def value(data):
        return best_forces(data[0], data[1], objective, limits=data[2]).value

    values, forward = jax.jvp(value, (data,), (moved,))
    assert np.isfinite(values).all()
    gradient = values_and_pull(data, objective)[1](jnp.ones_like(values))[0]
    pulled = sum(jnp.sum(g * m) for g, m in zip(jax.tree.leaves(gradient), jax.tree.leaves(moved), strict=True))
    assert np.isclose(pulled, forward.sum(), rtol=1e-8, atol=1e-8)
    # A margin is found to 1e-7, no better.
    step, near = (3e-4, 3e-3) if objective == "largest_margin" else (1e-5, 1e-4)
    ahead = value(jax.tree.map(lambda x, m: x + step * m, data, moved))
    behind = value(jax.tree.map(lambda x, m: x - step * m, data, moved))
    difference = (ahead - behind) / (2 * step)
    close = np.abs(difference - forward) <= near * np.maximum(np.abs(forward), np.abs(values)) + 1e-7
    # A step over a kink of the value, where another bound takes over, shows no derivative.
    assert close.mean() > 0.9


@pytest.mark.slow
@pytest.mark.parametrize("objective", ["least_norm", "least_maximal_force", "least_torque"])
def test_slopes_are_those_of_an_independent_oracle(objective):
    """Differences of Clarabel's own values, as wrench and contacts move; nothing of ours but the derivative."""
    made = made_of("ordinary", limited=True, seed=5)
    p = made.problem
    rng = np.random.default_rng(2)
    moves = rng.normal(size=p.wrench.shape) * np.abs(p.wrench), 1e-3 * rng.normal(size=p.points.shape)

    def value(t):
        grasp = eqx.tree_at(lambda g: g.points, all_there(made), p.points + t * moves[1])
        return best_forces(grasp, p.wrench + t * moves[0], objective, limits=made.limits).value

    value_there, forward = jax.jvp(value, (0.0,), (1.0,))
    step, compared = 1e-4, 0

    def valued(i: int, t: float) -> float:
        changes = {"wrench": p.wrench + t * moves[0], "points": p.points + t * moves[1], "squeeze": 0 * p.squeeze}
        case = made._replace(problem=p._replace(**changes)).case(i, np.ones((COUNT, N)))
        least_norm = objective == "least_norm"
        answer = (
            limited_reference.optimum(case, 1e-10) if least_norm else getattr(limited_reference, objective)(case, 1e-10)
        )
        if answer.status != "Solved":
            return np.nan
        # The optimum without squeezing minimises half the sum of squares.
        return np.sqrt(2 * answer.objective) if least_norm else answer.objective

    for i in np.flatnonzero(np.isfinite(value_there))[:16]:
        ahead, center, behind = (valued(i, t) for t in (step, 0.0, -step))
        slopes = np.array([ahead - center, center - behind]) / step
        # Where the two sides differ a bound takes over within the step.
        if not np.isfinite(slopes).all() or abs(slopes[0] - slopes[1]) > 1e-2 * (abs(slopes[0]) + 0.1 * center):
            continue
        compared += 1
        assert abs(slopes.mean() - forward[i]) <= 2e-3 * (abs(forward[i]) + 0.1 * center)
    assert compared >= 4


@pytest.mark.slow
@pytest.mark.parametrize("objective", ["least_maximal_force", "least_torque"])
def test_the_first_bit_of_friction_is_worth_what_the_derivative_says(objective):
    made = made_of("ordinary", limited=True, seed=5)
    first = jnp.arange(made.grasp.friction.shape[1]) == 0
    torsion = jnp.where(first, 0, made.grasp.torsion)

    def value(friction):
        grasp = eqx.tree_at(lambda g: (g.friction, g.torsion), all_there(made), (friction, torsion))
        return best_forces(grasp, made.problem.wrench, objective, limits=made.limits).value

    slick = jnp.where(first, 0.0, made.grasp.friction)
    values, forward = jax.jvp(value, (slick,), (jnp.where(first, jnp.ones_like(slick), 0),))
    step = 1e-5
    finite = np.isfinite(values)
    assert finite.sum() > 3
    difference = ((value(slick + step * first) - values) / step)[finite]
    assert (np.abs(forward[finite]) > 1e-3).any()
    assert np.allclose(difference, forward[finite], rtol=1e-3, atol=1e-4)


@pytest.mark.slow
def test_fingers_at_one_point_may_have_it_anywhere():
    normals = np.array([[1, 0, 0], [-0.5, 0.8, 0.3], [-0.5, -0.8, 0.3]])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    points = np.random.default_rng(0).normal(size=(8, 3))
    points[0] = 0
    force = np.array([0.02, 0.0, 1.0])
    units = np.ones((8, 3))
    grasp = Grasp(np.repeat(points[:, None], 3, 1), units[..., None] * normals, 0.8 * units, units, torsion=0.3 * units)
    wrench = np.concatenate([np.tile(force, (8, 1)), np.cross(points, force)], -1)
    for objective in OBJECTIVES[:3]:
        solution = jax.device_get(best_forces(grasp, wrench, objective, limits=Limits(normal_max=2 * units)))
        assert (solution.verdict == Verdict.OPTIMAL).all()
        assert np.allclose(solution.value, solution.value[0], rtol=1e-5), objective
        assert np.allclose(solution.bound, solution.value, rtol=1e-5), objective


@pytest.mark.slow
def test_least_torque_needs_no_bound_of_torques():
    made = made_of("ordinary", limited=True)
    torque_map = made.limits.torque_map
    endless = np.full((len(torque_map), JOINTS), np.inf)
    grasp = all_there(made)
    bounded = best_forces(
        grasp, made.problem.wrench, "least_torque", limits=Limits(torque_map=torque_map, torque_max=endless)
    )
    free = best_forces(grasp, made.problem.wrench, "least_torque", limits=Limits(torque_map=torque_map))
    np.testing.assert_array_equal(free.value, bounded.value)
    np.testing.assert_array_equal(free.forces, bounded.forces)


def test_what_cannot_be_exerted_is_proven():
    made = made_of("infeasible", limited=True)
    for objective in OBJECTIVES:
        solution = solve(made, objective)
        assert (solution.verdict == Verdict.INFEASIBLE).all() and not solution.forces.any()
        assert (solution.value == (-np.inf if objective == "largest_margin" else np.inf)).all()
        proof = jaxgrasp.verify_certificate(
            made.grasp,
            made.problem.wrench,
            solution.certificate,
            "uniform",
            limits=made.limits,
            rates=solution.certificate_rates,
        )
        assert (np.asarray(proof) > 1e3).all()


@pytest.mark.slow
def test_absent_contacts_change_nothing():
    made = made_of("ordinary", limited=True)
    p = made.problem

    def more(array, fill):
        extra = np.full((COUNT, 1, *array.shape[2:]), fill)
        return np.concatenate([array, extra], 1)

    grasp = made.grasp
    wider = Grasp(
        more(grasp.points, np.nan),
        more(grasp.normals, np.nan),
        more(grasp.friction, np.nan),
        more(grasp.squeeze, np.nan),
        more(np.ones_like(grasp.friction), 0.0),
        torsion=more(grasp.torsion, np.nan),
    )
    limits = made.limits
    wide = Limits(
        normal_min=more(limits.normal_min, np.nan),
        normal_max=more(limits.normal_max, np.nan),
        torque_map=more(limits.torque_map, np.nan),
        torque_max=limits.torque_max,
    )
    for objective in OBJECTIVES:
        plain, padded = solved("ordinary", True, objective), best_forces(wider, p.wrench, objective, limits=wide)
        assert np.allclose(plain.value, padded.value, rtol=1e-6, atol=1e-6)
        assert not np.asarray(padded.forces)[:, -1].any()


@pytest.mark.slow
def test_a_shared_grasp_and_a_mapped_call_are_the_batch():
    made = made_of("ordinary", limited=True)
    single = jax.tree.map(lambda x: x[0], (all_there(made), made.limits))
    wrenches = made.problem.wrench[0] * np.random.default_rng(4).uniform(0.9, 1.0, (COUNT, 1))
    repeated_single = jax.tree.map(lambda x: np.broadcast_to(x, (COUNT, *x.shape)), single)
    for objective in ("least_maximal_force", "least_torque"):
        shared = best_forces(single[0], wrenches, objective, limits=single[1])
        repeated = best_forces(repeated_single[0], wrenches, objective, limits=repeated_single[1])
        np.testing.assert_array_equal(shared.value, repeated.value)
        solve_single = partial(best_forces, single[0], objective=objective, limits=single[1])
        mapped = jax.vmap(solve_single)(jnp.asarray(wrenches[:3]))
        assert np.allclose(shared.value[:3], mapped.value, rtol=1e-6, atol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("objective", OBJECTIVES)
def test_single_precision_finds_the_same_to_its_digits(objective):
    made = made_of("ordinary", limited=True)
    exact = solved("ordinary", True, objective)
    single = jax.tree.map(lambda x: np.asarray(x, np.float32), (all_there(made), made.problem.wrench, made.limits))
    solution = best_forces(single[0], single[1], objective, limits=single[2])
    assert solution.value.dtype == np.float32
    good = np.asarray(solution.verdict) == Verdict.OPTIMAL
    # Two thirds or more; which ones hangs on rounding. Enough that the next line is about something.
    assert good.mean() > 0.5
    assert np.allclose(np.asarray(solution.value)[good], exact.value[good], rtol=3e-3, atol=3e-3)


def test_second_derivatives_are_refused():
    grasp = Grasp([[0.03, 0, 0], [-0.03, 0, 0]], [[-1.0, 0, 0], [1, 0, 0]], [0.5, 0.5], [9.0, 9.0])
    load = jnp.array([0, 0, 2.0, 0, 0, 0])
    with pytest.raises(NotImplementedError, match="first derivatives"):
        # Tracing refuses it: nothing is compiled.
        jax.eval_shape(jax.hessian(lambda w: best_forces(grasp, w, "least_maximal_force").value), load)


@pytest.mark.usefixtures("unchecked")
def test_bad_options_are_named():
    grasp = Grasp([[0.03, 0, 0], [-0.03, 0, 0]], [[-1.0, 0, 0], [1, 0, 0]], [0.5, 0.5], [9.0, 9.0])
    load = np.zeros(6)
    with pytest.raises(ValueError, match="objective is 'smallest': expected 'least_norm'"):
        best_forces(grasp, load, "smallest")
    with pytest.raises(ValueError, match="torque_map is None"):
        best_forces(grasp, load, "least_torque")
    with pytest.raises(ValueError, match="normal_max is None"):
        best_forces(grasp, load, "largest_margin")
    with pytest.raises(ValueError, match="wrench has shape"):
        best_forces(grasp, np.zeros(5), "least_norm")


def test_bad_numbers_are_a_verdict():
    made = made_of("ordinary", limited=True)
    wrench = made.problem.wrench.copy()
    wrench[2] = np.nan
    friction = made.grasp.friction.copy()
    friction[5, 1] = -1
    grasp = eqx.tree_at(lambda g: g.friction, all_there(made), friction)
    for objective in OBJECTIVES:
        solution = jax.device_get(best_forces(grasp, wrench, objective, limits=made.limits))
        assert solution.verdict[2] == solution.verdict[5] == Verdict.INVALID_DATA
        assert np.isfinite(solution.forces).all() and not np.isnan(solution.value).any()
