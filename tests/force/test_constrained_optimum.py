"""Laws of the constrained optimum: allowed, balanced, best; on nasty problems see ``test_stress.py``.

Every answer is judged by ``jaxgrasp.testing.references`` alone: extended precision, nothing of the solver's own.
"""

import jax
import numpy as np
import pytest

import jaxgrasp
from jaxgrasp import Grasp, Verdict
from jaxgrasp.testing import problems as P
from jaxgrasp.testing import references as R

COUNT = 64
GAP, BALANCE, ROUNDING = 1e-8, 1e-10, 1e-13


def solve(problem: P.Problems, weights, present: np.ndarray | None = None, safety=1.0):
    grasp = Grasp(problem.points, problem.normals, problem.friction, problem.squeeze, present)
    return jax.device_get(jaxgrasp.constrained_optimum(grasp, problem.wrench, weights, safety=safety))


def solved(solution) -> np.ndarray:
    return (solution.verdict == Verdict.OPTIMAL) | (solution.verdict == Verdict.CLOSED_FORM_OPTIMAL)


def lane(problem: P.Problems, i: int) -> P.Problems:
    return problem._replace(**{name: getattr(problem, name)[i : i + 1] for name in R.ARRAYS})


def relative(forces: np.ndarray, expected: np.ndarray) -> np.ndarray:
    return np.abs(forces - expected).max((1, 2)) / np.abs(expected).max((1, 2))


@pytest.fixture(
    scope="module",
    params=[(3, "squeeze"), (5, "uniform"), pytest.param((5, "squeeze"), marks=pytest.mark.slow)],
    ids=str,
)
def case(request):
    """Return ordinary problems, their weights, their solution and its judgement."""
    n, sharing = request.param
    problem = P.problems("ordinary", n, COUNT, seed=1)
    weights = problem.weights(sharing)
    solution = solve(problem, weights)
    return problem, weights, solution, R.judge(problem, weights, solution.forces, solution.multiplier)


def test_ordinary_problems_are_solved(case):
    _, _, solution, judgement = case
    assert solved(solution).all()
    assert 0.25 < (solution.verdict == Verdict.OPTIMAL).mean() < 0.8  # half of them have an active cone
    assert judgement.gap.max() < GAP
    assert judgement.backward_error.max() < BALANCE
    assert judgement.violation.max() < ROUNDING
    assert (solution.certificate == 0).all() and (solution.rank == 6).all()


def test_objective_is_that_of_the_forces(case):
    _, _, solution, judgement = case
    np.testing.assert_allclose(solution.objective, np.asarray(judgement.primal, float), rtol=1e-11)


def test_friction_has_a_price(case):
    """The closed form is a relaxation: no dearer, and the same where its forces are allowed."""
    problem, weights, solution, _ = case
    grasp = Grasp(problem.points, problem.normals, problem.friction, problem.squeeze)
    closed = jax.device_get(jaxgrasp.closed_form(grasp, problem.wrench, weights))
    is_closed_form = closed.verdict == Verdict.CLOSED_FORM_OPTIMAL
    assert (is_closed_form == (solution.verdict == Verdict.CLOSED_FORM_OPTIMAL)).all()
    assert relative(solution.forces[is_closed_form], closed.forces[is_closed_form]).max() < 1e-14
    assert (solution.steps[is_closed_form] == 0).all() and (solution.steps[~is_closed_form] > 0).all()
    squeeze_cost = np.sum(np.where(weights > 0, problem.squeeze**2 / (2 * weights), 0), -1)
    scale = np.maximum(solution.objective, squeeze_cost)
    assert (
        solution.objective[~is_closed_form] > closed.objective[~is_closed_form] - GAP * scale[~is_closed_form]
    ).all()
    assert ((solution.objective - closed.objective)[~is_closed_form] > 1e-6 * scale[~is_closed_form]).mean() > 0.9


def test_agrees_with_clarabel(case):
    problem, weights, solution, judgement = case
    compared = 0
    for i in range(COUNT):
        forces, multiplier, status = R.clarabel_optimum(problem, weights, i)
        other_judgement = R.judge(lane(problem, i), weights[i : i + 1], forces[None], multiplier[None])
        # Clarabel stops early now and then: its own gap says whether it can serve as a reference.
        if not status.endswith("Solved") or other_judgement.gap[0] > 1e-9 or other_judgement.backward_error[0] > 1e-9:
            continue
        compared += 1
        scale = max(judgement.primal[i], other_judgement.primal[0])
        assert abs(judgement.primal[i] - other_judgement.primal[0]) <= 2 * GAP * scale
        # Strong convexity turns a gap into a distance of forces: |f - g|^2 / 2k <= gap.
        largest = np.abs(forces).max()
        assert np.abs(solution.forces[i] - forces).max() <= 1e-3 * largest
    assert compared > 0.8 * COUNT


def turned(problem: P.Problems, q: np.ndarray) -> P.Problems:
    wrench = np.concatenate([problem.wrench[:, :3] @ q.T, problem.wrench[:, 3:] @ q.T], -1)
    return problem._replace(points=problem.points @ q.T, normals=problem.normals @ q.T, wrench=wrench)


def moved(problem: P.Problems, offset: np.ndarray) -> P.Problems:
    force = problem.wrench[:, :3]
    wrench = np.concatenate([force, problem.wrench[:, 3:] + np.cross(offset, force)], -1)
    return problem._replace(points=problem.points + offset, wrench=wrench)


def same_answer(solution, forces, expected):
    assert solved(solution).all()
    assert relative(forces, expected.forces).max() < 1e-7


def test_rotation_turns_the_forces(case):
    problem, weights, solution, _ = case
    q, _ = np.linalg.qr(np.random.default_rng(2).normal(size=(3, 3)))
    q *= np.linalg.det(q)
    other_solution = solve(turned(problem, q), weights)
    same_answer(other_solution, other_solution.forces @ q, solution)


def test_moving_the_frame_changes_nothing(case):
    problem, weights, solution, _ = case
    other_solution = solve(moved(problem, np.array([0.5, -1.0, 2.0])), weights)
    same_answer(other_solution, other_solution.forces, solution)


@pytest.mark.parametrize("length, force", [(1e3, 1.0), (1.0, 1e-6), (1e-3, 1e6)])
def test_units_scale_the_forces(case, length, force):
    problem, weights, solution, _ = case
    scaled = problem._replace(
        points=problem.points * length,
        squeeze=problem.squeeze * force,
        wrench=problem.wrench * np.repeat([force, force * length], 3),
    )
    other_solution = solve(scaled, scaled.squeeze if weights is problem.squeeze else weights)
    same_answer(other_solution, other_solution.forces / force, solution)


def test_order_of_contacts_does_not_matter(case):
    problem, weights, solution, _ = case
    order = np.roll(np.arange(problem.squeeze.shape[1]), 2)
    shuffled = problem._replace(**{name: getattr(problem, name)[:, order] for name in P.Contacts._fields})
    other_solution = solve(shuffled, weights[:, order])
    assert relative(other_solution.forces, solution.forces[:, order]).max() < 1e-7


@pytest.fixture(scope="module")
def padded():
    """Return three contacts in five rows, the other two holding garbage."""
    three = P.problems("ordinary", 3, COUNT, seed=1)
    place = np.array([0, 2, 4])
    filled = {}
    for name in P.Contacts._fields:
        values = getattr(three, name)
        filled[name] = np.full((COUNT, 5, *values.shape[2:]), np.nan)
        filled[name][:, 1] = -1e30
        filled[name][:, place] = values
    present = np.zeros((COUNT, 5))
    present[:, place] = 1
    return three, three._replace(**filled), present, place


@pytest.mark.slow
def test_absent_contacts_change_nothing(padded):
    three, wide, present, place = padded
    bare, padded_solution = solve(three, three.squeeze), solve(wide, wide.squeeze, present)
    assert (padded_solution.forces[:, [1, 3]] == 0).all()
    assert relative(padded_solution.forces[:, place], bare.forces).max() < 1e-8
    assert (padded_solution.verdict == bare.verdict).all()


@pytest.mark.slow
def test_nobody_there(padded):
    _, wide, present, _ = padded
    nobody = solve(wide, wide.squeeze, 0 * present)
    assert (nobody.verdict == Verdict.NO_CONTACTS).all()
    assert (nobody.forces == 0).all() and (nobody.rank == 0).all()
    assert (np.sum(nobody.certificate * wide.wrench, -1) > 0).all()


@pytest.mark.slow
def test_known_answers_of_a_pair(padded):
    """Two antipodal contacts lift until friction ends; torque about their line is out of reach."""
    _, wide, present, _ = padded
    points, normals = wide.points.copy(), wide.normals.copy()
    points[:, 0], points[:, 2] = [1, 0, 0], [-1, 0, 0]
    normals[:, 0], normals[:, 2] = [-1, 0, 0], [1, 0, 0]
    pair = np.zeros_like(present)
    pair[:, [0, 2]] = 1
    wrench = np.zeros((COUNT, 6))
    wrench[:, 2] = 2.0
    wrench[1, 3] = 1.0
    friction, squeeze = np.full_like(present, 0.5), np.full_like(present, 4.0)
    friction[2] = 0.2  # less than a quarter: the squeezing of 4 N no longer holds 1 N a contact
    problem = P.Problems("pair", points, normals, friction, squeeze, wrench, None)
    solution = solve(problem, problem.squeeze, pair)
    np.testing.assert_allclose(solution.forces[0, [0, 2]], [[-4, 0, 1], [4, 0, 1]], atol=1e-12)
    assert solution.verdict[0] == Verdict.CLOSED_FORM_OPTIMAL and solution.rank[0] == 5
    assert solution.verdict[1] == Verdict.INFEASIBLE
    direction = solution.certificate[1] / np.linalg.norm(solution.certificate[1])
    np.testing.assert_allclose(direction, [0, 0, 0, 1, 0, 0], atol=1e-12)
    assert solution.verdict[2] == Verdict.OPTIMAL
    # Presses just hard enough: 5 N, so that the largest force is (W/2) sqrt(1 + 1/mu^2).
    np.testing.assert_allclose(solution.forces[2, [0, 2]], [[-5, 0, 1], [5, 0, 1]], atol=1e-8)
    largest = np.linalg.norm(solution.forces[2], axis=-1).max()
    np.testing.assert_allclose(largest, np.sqrt(1 + 1 / 0.2**2), rtol=1e-8)


@pytest.mark.slow
def test_nothing_pulls_without_friction():
    """Two slippery contacts face to face: all of the load is the one's that can press against it."""
    line = np.array([[1.0, 0, 0], [-1, 0, 0]])
    grasp = Grasp(np.zeros((2, 3)), line, friction=np.zeros(2), squeeze=np.ones(2))
    solution = jaxgrasp.constrained_optimum(grasp, np.array([10.0, 0, 0, 0, 0, 0]))
    assert int(solution.verdict) == Verdict.OPTIMAL
    np.testing.assert_allclose(solution.forces, [[10, 0, 0], [0, 0, 0]], atol=1e-9)


@pytest.mark.slow
def test_named_sharings_are_their_weights():
    problem = P.problems("ordinary", 3, COUNT, seed=1)
    named = solve(problem, "squeeze")
    assert (named.forces == solve(problem, problem.squeeze).forces).all()


def test_weight_zero_keeps_its_squeezing_force():
    """Fixed contacts press with s a whatever happens; the others share the rest."""
    problem = P.problems("ordinary", 5, COUNT, seed=11)
    weights = np.ones((COUNT, 5))
    weights[:, 0] = 0
    rng = np.random.default_rng(12)
    held = problem.squeeze[:, :1, None] * problem.normals[:, :1]
    others = P.Contacts(*(getattr(problem, name)[:, 1:] for name in P.Contacts._fields))
    forces = np.concatenate([held, P.allowed_forces(rng, others, others.squeeze)], 1)
    problem = problem._replace(wrench=P.exact_wrench(problem.points, forces))
    solution = solve(problem, weights)
    assert solved(solution).all()
    np.testing.assert_allclose(solution.forces[:, :1], held, rtol=1e-14, atol=1e-14)
    judgement = R.judge(problem, weights, solution.forces, solution.multiplier)
    assert (
        judgement.gap.max() < GAP and judgement.backward_error.max() < BALANCE and judgement.violation.max() < ROUNDING
    )


@pytest.mark.slow
def test_safety_divides_the_friction():
    problem = P.problems("ordinary", 3, COUNT, seed=1)
    plain = solve(problem._replace(friction=problem.friction / 1.25), problem.squeeze)
    safe = solve(problem, problem.squeeze, safety=1.25)
    assert relative(safe.forces, plain.forces).max() < 1e-12 and (safe.verdict == plain.verdict).all()
    across = safe.forces - np.sum(safe.forces * problem.normals, -1, keepdims=True) * problem.normals
    used = np.linalg.norm(across, axis=-1) / np.maximum(np.sum(safe.forces * problem.normals, -1), 1e-300)
    limit = problem.friction / 1.25 * (1 + 1e-9)
    assert (used <= limit)[solved(safe)].all()
    for bad in (0.0, -1.0, float("nan"), np.array([1.0, 0.0])):
        with pytest.raises(ValueError, match="safety is"):
            solve(problem, problem.squeeze, safety=bad)
    with pytest.raises(ValueError, match=r"safety has shape \(5,\): expected .* \(64,\)"):
        solve(problem, problem.squeeze, safety=np.ones(5))


@pytest.mark.slow
def test_safety_is_that_of_a_problem_not_of_a_contact():
    """The safety factor has one value for each problem, also where there are as many problems as contacts."""
    problem = P.problems("ordinary", 3, 3, seed=1)
    safety = np.array([1.0, 1.5, 2.0])
    by_problem = solve(problem, problem.squeeze, safety=safety)
    divided = solve(problem._replace(friction=problem.friction / safety[:, None]), problem.squeeze)
    np.testing.assert_array_equal(by_problem.forces, divided.forces)


@pytest.mark.slow
def test_absent_friction_does_not_spoil_the_derivative_by_safety():
    """A fourth contact is absent: the other three must hold alone, and can."""
    problem = P.problems("low_friction", 3, 3, seed=1)
    arrays = (problem.points, problem.normals, problem.friction, problem.squeeze)
    points, normals, friction, squeeze = (np.concatenate([array, array[:, 2:]], 1) for array in arrays)
    present = np.tile([1.0, 1, 1, 0], (3, 1))

    def total(safety, friction):
        grasp = Grasp(points, normals, friction, squeeze, present)
        return jaxgrasp.constrained_optimum(grasp, problem.wrench, safety=safety).objective.sum()

    unknown = np.where(present > 0, friction, np.nan)
    spoiled, clean = (jax.grad(total)(1.0, coefficient) for coefficient in (unknown, friction))
    assert clean > 0 and spoiled == clean


def test_bad_data_leave_their_neighbours_alone(case):
    problem, weights, solution, _ = case
    arrays = {name: getattr(problem, name).copy() for name in R.ARRAYS}
    arrays["points"][3, 1, 0] = np.nan
    arrays["normals"][10, 0] = 0.0
    arrays["friction"][20, 2] = -0.5
    arrays["squeeze"][30, 1] = np.inf
    arrays["wrench"][40, 4] = np.nan
    bad = np.isin(np.arange(COUNT), [3, 10, 20, 30, 40])
    other_solution = solve(problem._replace(**arrays), weights)
    assert (other_solution.verdict[bad] == Verdict.INVALID_DATA).all()
    assert (other_solution.verdict[~bad] == solution.verdict[~bad]).all()
    assert relative(other_solution.forces[~bad], solution.forces[~bad]).max() < 1e-12
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(other_solution))
