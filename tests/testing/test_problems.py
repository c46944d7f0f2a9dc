"""Laws of the generated problems: replayable, in reach, feasible or not as they say, and as hard as they say."""

import sys

import numpy as np
import pytest
from scipy.optimize import linprog

from jaxgrasp.testing import problems as P
from jaxgrasp.testing import reachable_limits as L
from jaxgrasp.testing import references as R

SIZES = (1, 2, 3, 5)
COUNT, SEED = 32, 7
MADE = [(kind, n) for kind in P.KINDS for n in SIZES if n >= P.LEAST_CONTACTS.get(kind, 1)]


@pytest.fixture(scope="module")
def made() -> dict[tuple[str, int], P.Problems]:
    return {(kind, n): P.problems(kind, n, COUNT, SEED) for kind, n in MADE}


def arrays(problem: P.Problems) -> list[np.ndarray]:
    return [getattr(problem, name) for name in R.ARRAYS]


@pytest.mark.parametrize("kind", P.KINDS)
def test_a_seed_replays_its_problems(kind, made):
    again, by_other_seed = P.problems(kind, 3, COUNT, SEED), P.problems(kind, 3, COUNT, SEED + 1)
    assert all((a == b).all() for a, b in zip(arrays(made[kind, 3]), arrays(again)))
    assert not (again.points == by_other_seed.points).any()


@pytest.mark.parametrize("kind, n", MADE)
def test_data_are_sound(kind, n, made):
    problem = made[kind, n]
    assert [a.shape for a in arrays(problem)] == [(COUNT, n, 3)] * 2 + [(COUNT, n)] * 2 + [(COUNT, 6)]
    assert all(np.isfinite(a).all() for a in arrays(problem))
    np.testing.assert_allclose(np.linalg.norm(problem.normals, axis=-1), 1, atol=1e-15)
    assert (problem.friction >= 0).all() and (problem.squeeze >= 0).all()


@pytest.mark.parametrize("kind, n", MADE)
def test_wrenches_lie_in_the_range(kind, n, made):
    """Up to the rounding of a wrench whose frame may lie thousands of radii away."""
    centred_problem = R.centred(made[kind, n], np.ones((COUNT, n)))
    velocities = [centred_problem.velocities(np.broadcast_to(e, (COUNT, 6))) for e in np.eye(6, dtype=R.Wide)]
    matrix = np.asarray(np.stack(velocities, 1).reshape(COUNT, 6, -1), float)
    left, sizes, _ = np.linalg.svd(matrix, full_matrices=False)
    unreached = np.eye(6) - (left * (sizes > 1e-12 * sizes[:, :1])[:, None]) @ left.swapaxes(1, 2)
    residual = np.linalg.norm(np.einsum("bij,bj->bi", unreached, np.asarray(centred_problem.wrench, float)), axis=-1)
    assert np.all(
        residual <= 1e-11 * np.asarray(R.norm(centred_problem.wrench) + centred_problem.squeeze.sum(-1), float)
    )


@pytest.mark.parametrize("kind, n", MADE)
def test_witnesses_are_allowed_and_balance(kind, n, made):
    problem = made[kind, n]
    if problem.feasible is not True:
        assert problem.witness is None or kind == "zero_squeeze"
        return
    centred_problem = R.centred(problem, np.ones((COUNT, n)))
    forces = problem.witness.astype(R.Wide)
    outside = R.norm(forces - R.project(forces, centred_problem.normals, centred_problem.friction))
    assert np.all(outside <= 1e-15 * R.norm(forces).max(-1, keepdims=True))
    assert R.backward_error(centred_problem, forces).max() < 1e-11
    # What is not squeezed does not press, so method B can give these wrenches too.
    assert (forces[problem.squeeze == 0] == 0).all()


@pytest.mark.parametrize("kind", ["infeasible", "limit_101", "limit_10001"])
@pytest.mark.parametrize("n", [1, 2, 5])
def test_clarabel_finds_no_forces_either(kind, n, made):
    problem = made[kind, n]
    assert problem.feasible is False
    statuses = [R.clarabel_optimum(problem, np.ones((COUNT, n)), i)[2] for i in range(8)]
    # So near the limit it may stop early, and say so; it must not say that it solved one.
    assert not {"Solved", "AlmostSolved"} & set(statuses) and statuses.count("PrimalInfeasible") >= 4


@pytest.mark.parametrize("n, low, high", [(3, 0.35, 0.55), (5, 0.4, 0.6)])
def test_half_of_the_ordinary_optima_have_an_active_cone(n, low, high):
    problem = P.problems("ordinary", n, 400, SEED)
    forces, _ = R.closed_form_reference(problem, problem.squeeze)
    inside = R.norm(forces - R.project(forces, problem.normals.astype(R.Wide), problem.friction)).max(-1)
    assert low < np.mean(inside > 1e-12 * R.norm(forces).max(-1)) < high


def test_combined_is_all_at_once():
    problem = P.problems("combined", 10, 400, SEED)
    assert {0.0, 10.0} < set(problem.friction.ravel().tolist())
    assert (problem.squeeze == 0).any() and (problem.squeeze > 0).any(-1).all()
    frame = R.norm(R.centred(problem, np.ones((400, 10))).centre) / R.centred(problem, np.ones((400, 10))).length
    assert frame.max() > 100


def test_what_cannot_be_made_is_refused():
    for kind, least in P.LEAST_CONTACTS.items():
        with pytest.raises(ValueError, match=f"{kind} problems need at least {least} contacts"):
            P.problems(kind, least - 1, 1, 0)
    for kind, n in [("ordinary", 0), ("slippery", 3)]:
        with pytest.raises(ValueError, match="n is 0|kind is 'slippery'"):
            P.problems(kind, n, 1, 0)


def test_missing_solver_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "clarabel", None)
    with pytest.raises(ImportError, match=r"pip install 'jaxgrasp\[bench\]'"):
        P.problems("limit_99", 3, 1, 0)


def pair(wrench: list[float], friction: float = 0.5) -> P.Problems:
    """Return two contacts that face each other along x, two metres apart, squeezed by 4 N."""
    points, normals = np.array([[[1.0, 0, 0], [-1, 0, 0]]]), np.array([[[-1.0, 0, 0], [1, 0, 0]]])
    units = np.ones((1, 2))
    return P.Problems("pair", points, normals, friction * units, 4 * units, np.array([wrench], float), None)


def only(problem: P.Problems) -> P.Problems:
    """Return the problem with its first contact alone."""
    return problem._replace(**{name: getattr(problem, name)[:, :1] for name in P.Contacts._fields})


UP = np.array([[0, 0, 1.0, 0, -1.0, 0]])
"""A force along z through the first contact."""


def test_limit_of_one_contact_is_its_friction():
    limit = L.reachable_limit(only(pair([-6, 0, 0, 0, 0, 0])), np.ones((1, 1)), UP)
    assert limit.lower[0] <= 3 <= limit.upper[0]
    assert limit.width[0] < 1e-9
    np.testing.assert_allclose(limit.forces[0], [[-6, 0, 3]], rtol=1e-9)


def test_limit_with_a_contact_that_keeps_its_squeeze():
    """The second contact presses with 4 N whatever happens: the first must give 10 N in all, so 5 N of friction."""
    limit = L.reachable_limit(pair([-6, 0, 0, 0, 0, 0]), np.array([[1.0, 0]]), UP)
    assert limit.lower[0] <= 5 <= limit.upper[0]
    assert limit.width[0] < 1e-9
    np.testing.assert_allclose(limit.forces[0], [[-10, 0, 5], [4, 0, 0]], rtol=1e-9)


def test_a_pinch_lifts_without_limit():
    limit = L.reachable_limit(pair([0] * 6), np.ones((1, 2)), np.array([[0, 0, 1.0, 0, 0, 0]]))
    assert limit.lower[0] == limit.upper[0] == np.inf


def test_nothing_is_proven_where_nothing_is_reachable():
    """A contact that pushes towards -x cannot give a force along x, however much is pushed upwards."""
    limit = L.reachable_limit(only(pair([6, 0, 0, 0, 0, 0])), np.ones((1, 1)), UP)
    assert limit.lower[0] == -np.inf and limit.width[0] == np.inf


def pyramid_limit(problem: P.Problems, direction: np.ndarray, i: int, reach: float, sides: int = 128) -> float:
    """Return theta with each cone replaced by a pyramid of ``sides`` edges, ``reach`` times the friction long: a linear
    program in the edges' lengths."""
    angles = 2 * np.pi * np.arange(sides) / sides
    columns = []
    for p, a, m in zip(problem.points[i], problem.normals[i], problem.friction[i]):
        first, second = R.tangents(a)
        edges = a + reach * m * (np.cos(angles)[:, None] * first + np.sin(angles)[:, None] * second)
        columns.append(np.concatenate([edges, np.cross(p, edges)], 1))
    matrix = np.concatenate([*columns, -direction[i][None]]).T
    cost = np.zeros(matrix.shape[1])
    cost[-1] = -1
    bounds = [(0, None)] * (len(cost) - 1) + [(None, None)]
    scale = np.array([1, 1, 1, 20, 20, 20])
    return linprog(cost, A_eq=scale[:, None] * matrix, b_eq=scale * problem.wrench[i], bounds=bounds).x[-1]


@pytest.mark.parametrize("n", [3, 8])
def test_limits_lie_between_those_of_pyramids(n):
    problem = P.problems("limit_99", n, 12, SEED)
    rng = np.random.default_rng(SEED)
    # Back inside, away from the limit that these wrenches are near.
    inner = P.allowed_forces(rng, P.Contacts(*arrays(problem)[:4]), problem.squeeze)
    problem = problem._replace(wrench=P.exact_wrench(problem.points, inner))
    direction = P.exact_wrench(problem.points, rng.normal(size=(12, n, 3)))
    limit = L.reachable_limit(problem, problem.squeeze, direction)
    bounded = limit.width < 1e-6
    assert bounded.sum() >= 4
    assert (limit.lower <= limit.upper).all()
    for i in np.flatnonzero(bounded):
        inscribed = pyramid_limit(problem, direction, i, 1.0)
        around = pyramid_limit(problem, direction, i, 1 / np.cos(np.pi / 128))
        assert inscribed * (1 - 1e-7) <= limit.upper[i] and limit.lower[i] <= around * (1 + 1e-7)
