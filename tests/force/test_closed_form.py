"""Laws of the closed form: it balances the wrench, agrees with independent routes, and does not see the frame."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxgrasp
from jaxgrasp import Grasp, Verdict
from jaxgrasp.testing import problems as P
from jaxgrasp.testing import references as R

COUNT, N = 64, 5
SHARINGS = ("squeeze", "uniform")


def solve(problem: P.Problems, weights: np.ndarray, present: np.ndarray | None = None):
    grasp = Grasp(problem.points, problem.normals, problem.friction, problem.squeeze, present)
    return jax.device_get(jaxgrasp.closed_form(grasp, problem.wrench, weights))


def relative(forces: np.ndarray, expected: np.ndarray) -> np.ndarray:
    """Return the largest difference of a problem's forces, relative to its largest force."""
    expected = np.asarray(expected, float)
    return np.abs(forces - expected).max((1, 2)) / np.linalg.norm(expected, axis=-1).max(-1)


@pytest.fixture(scope="module")
def ordinary() -> P.Problems:
    return P.problems("ordinary", N, COUNT, seed=1)


@pytest.fixture(scope="module", params=SHARINGS)
def case(request, ordinary):
    """Return ordinary problems, their weights, and their solution."""
    weights = ordinary.weights(request.param)
    return ordinary, weights, solve(ordinary, weights)


@pytest.mark.slow
def test_named_sharings_are_their_weights(ordinary):
    grasp = Grasp(ordinary.points, ordinary.normals, ordinary.friction, ordinary.squeeze)
    for sharing in SHARINGS:
        named = jaxgrasp.closed_form(grasp, ordinary.wrench, sharing)
        np.testing.assert_allclose(named.forces, solve(ordinary, ordinary.weights(sharing)).forces, rtol=0, atol=1e-13)


def test_balances_the_wrench(case):
    problem, weights, solution = case
    total = np.einsum("bij,bj->bi", jaxgrasp.grasp_matrix(problem.points), solution.forces.reshape(COUNT, -1))
    np.testing.assert_allclose(total, problem.wrench, atol=1e-13 * np.abs(solution.forces).sum())
    assert R.judge(problem, weights, solution.forces, solution.multiplier).backward_error.max() < 1e-14
    assert solution.residual.max() < 1e-14
    assert (solution.rank == 6).all() and (solution.steps == 0).all() and (solution.certificate == 0).all()


def test_agrees_with_the_lagrange_system(case):
    problem, weights, solution = case
    grasp = Grasp(problem.points, problem.normals, problem.friction, problem.squeeze)
    forces, multiplier = jaxgrasp.literature.lagrange_forces(grasp, problem.wrench, weights)
    assert relative(solution.forces, forces).max() < 1e-10
    np.testing.assert_allclose(solution.multiplier, multiplier, rtol=1e-8, atol=1e-8 * np.abs(multiplier).max())


def test_agrees_with_the_pseudo_inverse(case):
    problem, weights, solution = case
    matrix = np.asarray(jaxgrasp.grasp_matrix(problem.points))
    squeezing = (problem.squeeze[..., None] * problem.normals).reshape(COUNT, -1)
    for i in range(COUNT):
        w = np.repeat(weights[i], 3)
        gain = w[:, None] * matrix[i].T @ np.linalg.pinv((matrix[i] * w) @ matrix[i].T)
        expected = squeezing[i] + gain @ (problem.wrench[i] - matrix[i] @ squeezing[i])
        assert relative(solution.forces[i : i + 1], expected.reshape(1, N, 3)) < 1e-9


def test_agrees_with_extended_precision(case):
    problem, weights, solution = case
    expected, rank = R.closed_form_reference(problem, weights)
    assert (rank == 6).all()
    assert relative(solution.forces, expected).max() < 1e-12


def test_objective_and_verdict_describe_the_forces(case):
    problem, weights, solution = case
    judgement = R.judge(problem, weights, solution.forces, solution.multiplier)
    np.testing.assert_allclose(solution.objective, np.asarray(judgement.primal, float), rtol=1e-12)
    inside = judgement.violation < 1e-13
    assert (solution.verdict == np.where(inside, Verdict.CLOSED_FORM_OPTIMAL, Verdict.OUTSIDE_CONES)).all()
    assert 0.2 < inside.mean() < 0.8  # both verdicts were put to the test


def test_unit_circle_known_answers():
    angle = np.arange(3) * 2 * np.pi / 3
    points = np.stack([np.cos(angle), np.sin(angle), 0 * angle], -1)
    up = np.array([0.0, 0, 3, 0, 0, 0])
    h = 4.330127018922193
    for squeeze, expected in (
        ([5.0, 5, 5], [[-5, 0, 1], [2.5, -h, 1], [2.5, h, 1]]),
        ([2.0, 5, 5], [[-2.5, 0, 1], [1.25, -h, 1], [1.25, h, 1]]),
    ):
        grasp = Grasp(points, -points, np.full(3, 0.5), np.array(squeeze))
        np.testing.assert_allclose(jaxgrasp.closed_form(grasp, up).forces, expected, atol=1e-13)


def test_antipodal_pair_known_answers():
    points = np.array([[1.0, 0, 0], [-1, 0, 0]])
    grasp = Grasp(points, -points, np.full(2, 0.5), np.full(2, 4.0))
    solution = jaxgrasp.closed_form(grasp, np.array([0.0, 0, 2, 0, 0, 0]))
    np.testing.assert_allclose(solution.forces, [[-4, 0, 1], [4, 0, 1]], atol=1e-13)
    assert int(solution.rank) == 5
    twisted = jaxgrasp.closed_form(grasp, np.array([0.0, 0, 2, 1, 0, 0]))
    assert int(twisted.verdict) == Verdict.INFEASIBLE
    direction = np.asarray(twisted.certificate)
    np.testing.assert_allclose(direction / np.linalg.norm(direction), [0, 0, 0, 1, 0, 0], atol=1e-12)


def test_one_contact_carries_what_it_can():
    point = np.array([[0.3, -0.2, 0.1]])
    grasp = Grasp(point, np.array([[0.0, 0, 1]]), np.array([0.5]), np.array([2.0]))
    force = np.array([0.1, 0.2, 3.0])
    solution = jaxgrasp.closed_form(grasp, np.concatenate([force, np.cross(point[0], force)]))
    np.testing.assert_allclose(solution.forces, force[None], atol=1e-13)
    assert int(solution.rank) == 3 and int(solution.verdict) == Verdict.CLOSED_FORM_OPTIMAL


def rotation(seed: int) -> np.ndarray:
    q, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    return q * np.linalg.det(q)


def test_rotation_turns_the_forces(case):
    problem, weights, solution = case
    q = rotation(2)
    turned = problem._replace(
        points=problem.points @ q.T,
        normals=problem.normals @ q.T,
        wrench=np.concatenate([problem.wrench[:, :3] @ q.T, problem.wrench[:, 3:] @ q.T], -1),
    )
    assert relative(solve(turned, weights).forces, solution.forces @ q.T).max() < 1e-11


def test_moving_the_frame_changes_nothing(case):
    problem, weights, solution = case
    offset = np.array([0.5, -1.0, 2.0])
    force = problem.wrench[:, :3]
    moved = problem._replace(
        points=problem.points + offset,
        wrench=np.concatenate([force, problem.wrench[:, 3:] + np.cross(offset, force)], -1),
    )
    other_solution = solve(moved, weights)
    assert relative(other_solution.forces, solution.forces).max() < 1e-11
    # A multiplier is a twist: its linear part is the velocity of the frame's origin.
    back = other_solution.multiplier[:, :3] + np.cross(other_solution.multiplier[:, 3:], offset)
    np.testing.assert_allclose(back, solution.multiplier[:, :3], atol=1e-10 * np.abs(other_solution.multiplier).max())


@pytest.mark.parametrize("length, force", [(1e-3, 1.0), (1e3, 1.0), (1.0, 1e-6), (1.0, 1e6), (1e3, 1e-6)])
def test_units_scale_the_forces(case, length, force):
    problem, weights, solution = case
    scale = np.repeat([force, force * length], 3)
    scaled = problem._replace(
        points=problem.points * length, squeeze=problem.squeeze * force, wrench=problem.wrench * scale
    )
    same_method = scaled.squeeze if weights is problem.squeeze else weights
    other_solution = solve(scaled, same_method)
    assert relative(other_solution.forces / force, solution.forces).max() < 1e-11
    assert (other_solution.verdict == solution.verdict).all()


def test_order_of_contacts_does_not_matter(case):
    problem, weights, solution = case
    order = np.array([3, 0, 4, 1, 2])
    shuffled = problem._replace(**{name: getattr(problem, name)[:, order] for name in P.Contacts._fields})
    assert relative(solve(shuffled, weights[:, order]).forces, solution.forces[:, order]).max() < 1e-12


@pytest.mark.parametrize("garbage", [np.nan, np.inf, -1e30, 0.0])
def test_absent_contacts_change_nothing(garbage):
    three = P.problems("ordinary", 3, COUNT, seed=4)
    weights = three.squeeze
    # In the middle, so that what is absent is not merely last.
    place = np.array([0, 2, 4])
    filled = {}
    for name in P.Contacts._fields:
        values = getattr(three, name)
        wide = np.full((COUNT, N, *values.shape[2:]), garbage)
        wide[:, place] = values
        filled[name] = wide
    present = np.zeros((COUNT, N))
    present[:, place] = 1
    wide_weights = np.full((COUNT, N), garbage)
    wide_weights[:, place] = weights
    padded = solve(three._replace(**filled), wide_weights, present)
    bare = solve(three, weights)
    assert (padded.forces[:, [1, 3]] == 0).all()
    assert relative(padded.forces[:, place], bare.forces).max() < 1e-12
    assert (padded.verdict == bare.verdict).all() and (padded.rank == bare.rank).all()


def test_no_squeeze_no_force_in_method_b():
    problem = P.problems("some_zero_squeeze", N, COUNT, seed=5)
    solution = solve(problem, problem.squeeze)
    idle = problem.squeeze == 0
    assert idle.any()
    assert (solution.forces[idle] == 0).all()
    assert np.isfinite(solution.forces).all()


def test_nothing_squeezes():
    problem = P.problems("zero_squeeze", N, COUNT, seed=5)
    solution = solve(problem, problem.squeeze)
    assert (solution.verdict == Verdict.NO_CONTACTS).all() and (solution.rank == 0).all()
    assert (solution.forces == 0).all()
    # The unbalanced wrench itself proves it.
    work = np.sum(solution.certificate * problem.wrench, -1)
    assert (work > 0).all()


def test_split_sums_to_the_closed_form(case):
    problem, weights, solution = case
    grasp = Grasp(problem.points, problem.normals, problem.friction, problem.squeeze)
    external, internal = map(np.asarray, jaxgrasp.split_forces(grasp, problem.wrench, weights))
    assert relative(external + internal, solution.forces).max() < 1e-12
    matrix = np.asarray(jaxgrasp.grasp_matrix(problem.points))
    balance = np.einsum("bij,bj->bi", matrix, internal.reshape(COUNT, -1))
    carried = np.einsum("bij,bj->bi", matrix, external.reshape(COUNT, -1))
    np.testing.assert_allclose(balance, 0, atol=1e-13 * np.abs(internal).sum())
    np.testing.assert_allclose(carried, problem.wrench, atol=1e-13 * np.abs(external).sum())


def test_linear_in_the_wrench(case):
    """For fixed weights the forces are affine in the wrench and the squeeze together."""
    problem, weights, solution = case
    rng = np.random.default_rng(6)
    other_problem = problem._replace(wrench=rng.normal(size=(COUNT, 6)), squeeze=rng.uniform(0, 5, (COUNT, N)))
    mixed = problem._replace(
        wrench=2 * problem.wrench - 3 * other_problem.wrench, squeeze=2 * problem.squeeze + 0 * other_problem.squeeze
    )
    still = other_problem._replace(squeeze=0 * other_problem.squeeze)
    expected = 2 * solution.forces - 3 * solve(still, weights).forces
    assert relative(solve(mixed, weights).forces, expected).max() < 1e-10


@pytest.mark.parametrize("kind", ["coincident_some", "coincident_all", "near_collinear", "zero_wrench", "combined"])
@pytest.mark.parametrize("sharing", SHARINGS)
def test_degenerate_grasps_match_extended_precision(kind, sharing):
    problem = P.problems(kind, N, COUNT, seed=7)
    weights = problem.weights(sharing)
    solution = solve(problem, weights)
    expected, rank = R.closed_form_reference(problem, weights)
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(solution))
    assert (solution.rank == rank).all()
    assert (solution.verdict <= Verdict.OUTSIDE_CONES).all()
    # Two roundings of the forces, in the unit that stands in place of a load of zero.
    assert solution.residual.max() < 1e-9
    # At a spread of 1e-7 rounding of the data alone moves the forces by 1e-9; metres away, by more.
    assert relative(solution.forces, expected).max() < (1e-5 if kind == "combined" else 1e-7)


def test_balance_is_rounding_near_a_line_too():
    problem = P.problems("near_collinear", N, COUNT, seed=7)
    solution = solve(problem, problem.squeeze)
    assert R.judge(problem, problem.squeeze, solution.forces, solution.multiplier).backward_error.max() < 1e-13


def test_minimal_multiplier_where_it_is_not_unique():
    """Coincident contacts cannot turn the object: the multiplier has no angular part."""
    problem = P.problems("coincident_all", N, COUNT, seed=8)
    solution = solve(problem, problem.squeeze)
    assert (solution.rank == 3).all()
    assert np.abs(solution.multiplier[:, 3:]).max() == 0


@pytest.mark.parametrize("n", [1, 2])
def test_few_contacts_stay_finite(n):
    problem = P.problems("ordinary", n, COUNT, seed=9)
    solution = solve(problem, problem.squeeze)
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(solution))
    assert (solution.rank == (3 if n == 1 else 5)).all()
    assert (solution.verdict <= Verdict.OUTSIDE_CONES).all()
    assert solution.residual.max() < 1e-13


def test_single_precision_in_single_precision_out(case):
    problem, weights, _ = case
    single = problem.cast(np.float32)
    solution = solve(single, weights.astype(np.float32))
    assert {leaf.dtype for leaf in jax.tree.leaves(solution)} == {np.dtype(np.float32), np.dtype(np.int32)}
    expected, _ = R.closed_form_reference(single, weights.astype(np.float32))
    assert relative(solution.forces, expected).max() < 1e-4
    assert solution.residual.max() < 1e-5


def test_bad_data_under_jit_leaves_neighbours_alone(case):
    problem, weights, solution = case
    broken = problem._replace(points=problem.points.copy(), wrench=problem.wrench.copy())
    broken.points[3, 1, 0] = np.nan
    broken.wrench[10, 4] = np.inf
    other_solution = solve(broken, weights)
    bad = np.isin(np.arange(COUNT), [3, 10])
    assert (other_solution.verdict[bad] == Verdict.INVALID_DATA).all()
    assert (other_solution.forces[~bad] == solution.forces[~bad]).all()
    assert np.isfinite(other_solution.forces).all()


def test_a_presence_that_is_no_number_is_no_absence():
    problem = P.problems("ordinary", 3, COUNT, seed=10)
    present = np.ones((COUNT, 3))
    present[4, 1], present[5, 1] = np.nan, 0
    grasp = Grasp(problem.points, problem.normals, problem.friction, problem.squeeze, present)
    verdict = np.asarray(jaxgrasp.closed_form(grasp, problem.wrench).verdict)
    np.testing.assert_array_equal(verdict == Verdict.INVALID_DATA, np.arange(COUNT) == 4)


def test_bad_sharing_and_shapes_are_named():
    problem = P.problems("ordinary", 3, 1, seed=0)
    grasp = Grasp(problem.points, problem.normals, problem.friction, problem.squeeze)
    with pytest.raises(ValueError, match="sharing is 'equal'"):
        jaxgrasp.closed_form(grasp, problem.wrench, "equal")
    with pytest.raises(ValueError, match="sharing is 'equal'"):
        jaxgrasp.split_forces(grasp, problem.wrench, "equal")
    with pytest.raises(ValueError, match=r"sharing has shape \(4,\): expected \(..., 3\)"):
        jaxgrasp.closed_form(grasp, problem.wrench, jnp.ones(4))
    with pytest.raises(ValueError, match=r"leading axes do not broadcast .* wrench \(2,\)"):
        many = jax.tree.map(lambda a: np.repeat(a, 3, 0), grasp)
        jaxgrasp.closed_form(many, np.repeat(problem.wrench, 2, 0))
