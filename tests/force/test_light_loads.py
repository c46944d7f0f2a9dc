"""Loads that are next to nothing beside the squeezing forces, and squeezing forces of every size in one grasp.

Whether allowed forces exist does not depend on the size of the load: a grasp that holds w holds w/10^12. So verdicts
must not depend on it either, and Clarabel, which is asked about the load at its ordinary size, judges them all.
"""

import jax
import numpy as np
import pytest

import jaxgrasp
from jaxgrasp import Grasp, Solution, Verdict
from jaxgrasp.testing import references as R

COUNT = 100
LIGHT = (1e-2, 1e-4, 3e-6, 3e-8, 3e-10, 3e-12, 1e-14, 1e-20)
ALLOWED = 1e-8
"""Part of a load that an optimum may miss, where double precision can do better."""
ROUNDINGS = 16
"""Roundings of the largest force, at its lever, that are granted where the load is lighter than they are."""


def sampled(n: int, seed: int) -> tuple[Grasp, np.ndarray]:
    """Return contacts anywhere on a unit sphere that press inward, and a random wrench of length 1."""
    rng = np.random.default_rng([seed, n])
    points = rng.normal(size=(COUNT, n, 3))
    points /= np.linalg.norm(points, axis=-1, keepdims=True)
    wrench = rng.normal(size=(COUNT, 6)) * (1, 1, 1, 0.3, 0.3, 0.3)
    wrench /= np.linalg.norm(wrench, axis=-1, keepdims=True)
    friction, squeeze = rng.uniform(0.2, 0.6, (COUNT, n)), rng.uniform(0.5, 5, (COUNT, n))
    return Grasp(points, -points, friction, squeeze), wrench


def exists(grasp: Grasp, wrench: np.ndarray) -> np.ndarray:
    """Return True where allowed forces of the wrench exist, by Clarabel; no problem drawn here is left open by it."""
    clarabel = pytest.importorskip("clarabel")
    sparse = pytest.importorskip("scipy.sparse")
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    feasible = []
    for points, normals, friction, load in zip(grasp.points, grasp.normals, grasp.friction, wrench, strict=True):
        n = len(points)
        rows, right, cones = [np.zeros((6, 3 * n))], [load], [clarabel.ZeroConeT(6)]
        for i, (point, normal, mu) in enumerate(zip(points, normals, friction, strict=True)):
            block = slice(3 * i, 3 * i + 3)
            rows[0][:3, block], rows[0][3:, block] = np.eye(3), np.cross(np.eye(3), point)
            cone = np.zeros((3, 3 * n))
            cone[0, block], cone[1:, block] = -mu * normal, -np.stack(R.tangents(normal))
            rows.append(cone)
            right.append(np.zeros(3))
            cones.append(clarabel.SecondOrderConeT(3))
        cost = normals.ravel()
        problem = sparse.csc_matrix(np.concatenate(rows))
        none = sparse.csc_matrix((3 * n, 3 * n))
        status = str(clarabel.DefaultSolver(none, cost, problem, np.concatenate(right), cones, settings).solve().status)
        assert status in ("Solved", "PrimalInfeasible"), status
        feasible.append(status == "Solved")
    return np.array(feasible)


@pytest.fixture(scope="module", params=[3, pytest.param(5, marks=pytest.mark.slow)])
def judged_grasps(request) -> tuple[Grasp, np.ndarray, np.ndarray]:
    grasp, wrench = sampled(request.param, seed=0)
    feasible = exists(grasp, wrench)
    assert 0.2 < feasible.mean() < 0.95
    return grasp, wrench, feasible


@jax.jit
def solve(grasp: Grasp, wrench: np.ndarray, weights: np.ndarray) -> Solution:
    return jaxgrasp.constrained_optimum(grasp, wrench, weights)


def residual_of(grasp: Grasp, wrench: np.ndarray, forces: np.ndarray) -> np.ndarray:
    """Return the residual of the balance, less what the forces' own rounding may contribute."""
    granted = ROUNDINGS * np.finfo(float).eps * np.linalg.norm(forces, axis=-1).sum(-1)
    return np.maximum(left_of(grasp, wrench, forces) - granted, 0)


def left_of(grasp: Grasp, wrench: np.ndarray, forces: np.ndarray) -> np.ndarray:
    """Return the length of the wrench that the forces leave unbalanced, in extended precision."""
    forces, points = np.asarray(forces, R.Wide), np.asarray(grasp.points, R.Wide)
    made = np.concatenate([forces.sum(1), np.cross(points, forces).sum(1)], -1)
    return np.linalg.norm(np.asarray(made - wrench, float), axis=-1)


def beyond_cones(grasp: Grasp, forces: np.ndarray) -> np.ndarray:
    """Return the distance of the forces from their cones, relative to the largest of them."""
    forces = np.asarray(forces, R.Wide)
    apart = R.norm(forces - R.project(forces, grasp.normals, grasp.friction)).max(-1)
    return np.asarray(apart / R.or_one(R.norm(forces).max(-1)), float)


@pytest.mark.parametrize("light", LIGHT)
@pytest.mark.parametrize("sharing", ["squeeze", "uniform"])
def test_what_holds_a_load_holds_a_lighter_one(judged_grasps, sharing, light):
    grasp, wrench, feasible = judged_grasps
    weights = grasp.squeeze if sharing == "squeeze" else np.ones_like(grasp.squeeze)
    solution = jax.device_get(solve(grasp, light * wrench, weights))
    held = np.isin(solution.verdict, [Verdict.CLOSED_FORM_OPTIMAL, Verdict.OPTIMAL, Verdict.FEASIBLE])
    np.testing.assert_array_equal(held, feasible)
    np.testing.assert_array_equal(solution.verdict == Verdict.INFEASIBLE, ~feasible)
    assert np.all(residual_of(grasp, light * wrench, solution.forces)[held] <= ALLOWED * light)
    assert np.all(beyond_cones(grasp, solution.forces)[held] <= 1e-13)
    # An optimum balances its load to 1e-8 of it; below that of the squeeze rounding hides what is best.
    best = np.isin(solution.verdict, [Verdict.CLOSED_FORM_OPTIMAL, Verdict.OPTIMAL])
    left, load = left_of(grasp, light * wrench, solution.forces), np.linalg.norm(light * wrench, axis=-1)
    # In lengths of one metre; in those of the grasp it is less.
    assert np.all(left[best] <= 6e-8 * load[best])
    assert np.array_equal(best, feasible) if light >= 1e-6 else np.any(solution.verdict == Verdict.FEASIBLE)


@pytest.mark.parametrize("light", [1.0, 3e-6, 1e-14])
def test_the_residual_is_what_is_missed_of_the_load(judged_grasps, light):
    grasp, wrench, feasible = judged_grasps
    solution = jax.device_get(solve(grasp, light * wrench, grasp.squeeze))
    assert np.all(solution.residual[feasible] < 8e-9)
    left = left_of(grasp, light * wrench, solution.forces)
    # In the grasp's own frame lengths are other units: a factor of a few.
    size = np.maximum(light, 4.8e-7 * np.linalg.norm(solution.forces, axis=-1).sum(-1))
    floor = 1e-9
    assert np.all(left[feasible] / size[feasible] <= 4 * solution.residual[feasible] + floor)


@pytest.mark.slow
@pytest.mark.parametrize(("dtype", "light"), [(np.float64, 1e-11), (np.float32, 1e-4)])
def test_no_closed_form_is_called_the_optimum_of_a_load_that_rounding_hides(dtype, light):
    """Method B, alone or beside the optimum, calls only forces optimal that balance the load, in both precisions."""
    grasp, wrench = jax.tree.map(lambda x: x.astype(dtype), sampled(10, seed=3))
    wrench = dtype(light) * wrench
    alone = jax.device_get(jaxgrasp.closed_form(grasp, wrench))
    closed, best = jax.device_get(jaxgrasp.closed_form_and_optimum(grasp, wrench))
    allowed = 2 * float(np.finfo(dtype).eps) ** 0.5
    for solution in (alone, closed, best):
        missed_of_load = left_of(grasp, wrench, solution.forces) / np.linalg.norm(wrench, axis=-1)
        optimum = np.isin(solution.verdict, [Verdict.CLOSED_FORM_OPTIMAL, Verdict.OPTIMAL])
        assert np.all(missed_of_load[optimum] <= allowed)
        hidden = solution.verdict == Verdict.FEASIBLE
        assert hidden.sum() > 20 and np.any(missed_of_load[hidden] > allowed)
        assert np.all(beyond_cones(grasp, solution.forces)[hidden] <= 100 * np.finfo(dtype).eps)
    np.testing.assert_array_equal(alone.verdict, closed.verdict)
    np.testing.assert_array_equal(best.verdict[alone.verdict == Verdict.FEASIBLE], Verdict.FEASIBLE)


@pytest.mark.parametrize("n", [3, *(pytest.param(n, marks=pytest.mark.slow) for n in (5, 8))])
def test_squeezing_forces_of_every_size_leave_no_verdict_open(n):
    grasp, wrench = sampled(n, seed=1)
    squeeze = 10 ** np.random.default_rng(n).uniform(-12, 6, (COUNT, n))
    grasp = Grasp(grasp.points, grasp.normals, grasp.friction, squeeze)
    feasible = exists(grasp, wrench)
    solution = jax.device_get(solve(grasp, wrench, squeeze))
    held = np.isin(solution.verdict, [Verdict.CLOSED_FORM_OPTIMAL, Verdict.OPTIMAL, Verdict.FEASIBLE])
    np.testing.assert_array_equal(held, feasible)
    np.testing.assert_array_equal(solution.verdict == Verdict.INFEASIBLE, ~feasible)
    assert np.all(residual_of(grasp, wrench, solution.forces)[held] <= ALLOWED)
    assert np.all(beyond_cones(grasp, solution.forces)[held] <= 1e-13)


@pytest.mark.slow
def test_two_contacts_hold_no_torque_about_their_line_however_light():
    """A pinch holds nothing that turns about its own line, not even what rounding of the pinch hides."""
    grasp = Grasp(
        np.array([[0.03, 0, 0], [-0.03, 0, 0]]), np.array([[-1.0, 0, 0], [1, 0, 0]]), np.full(2, 0.5), np.full(2, 3.0)
    )
    light = 10.0 ** -np.arange(0, 30, 3)
    turning, lifting = (light[:, None] * np.eye(6)[axis] for axis in (3, 2))
    verdicts = np.asarray(jaxgrasp.constrained_optimum(grasp, np.concatenate([turning, lifting])).verdict)
    np.testing.assert_array_equal(verdicts, np.repeat([Verdict.INFEASIBLE, Verdict.CLOSED_FORM_OPTIMAL], len(light)))


@pytest.mark.parametrize(
    ("n", "seed", "which"),
    [(3, 0, [2076]), (5, 0, [1343, 2882]), pytest.param(10, 1000, [942], marks=pytest.mark.slow)],
)
def test_lifts_that_ask_for_forces_of_ten_thousand_loads_are_decided(n, seed, which):
    """Next to the limit of what the grasp can exert: multipliers of 1e9, whose rounding is larger than 1e-8 loads."""
    rng = np.random.default_rng(seed + n)
    points = rng.normal(size=(4000, n, 3))
    points /= np.linalg.norm(points, axis=-1, keepdims=True)
    points[..., 2] = np.abs(points[..., 2])
    friction, squeeze = rng.uniform(0.2, 0.6, (4000, n)), rng.uniform(0.5, 5, (4000, n))
    grasp = Grasp(points[which], -points[which], friction[which], squeeze[which])
    wrench = np.tile([0, 0, 3.0, 0, 0, 0], (len(which), 1))
    assert exists(grasp, wrench).all()
    # As many as the other tests compile for.
    many = jax.tree.map(lambda x: np.resize(x, (COUNT, *x.shape[1:])), (grasp, wrench, grasp.squeeze))
    solution = jax.tree.map(lambda x: np.asarray(x)[: len(which)], solve(*many))
    assert np.all(solution.verdict == Verdict.OPTIMAL)
    assert np.all(np.linalg.norm(solution.forces, axis=-1).max(-1) > 1e4)
    assert np.all(residual_of(grasp, wrench, solution.forces) <= 3 * ALLOWED)
    assert np.all(beyond_cones(grasp, solution.forces) <= 1e-13)


@pytest.mark.slow
def test_what_is_allowed_answers_every_question_whether_or_not_it_is_the_optimum():
    """The least squeeze and the closest wrench do not hang on how unevenly a hand means to squeeze."""
    even, wrench = sampled(5, seed=1)
    squeeze = 10 ** np.random.default_rng(5).uniform(-12, 6, (COUNT, 5))
    uneven = Grasp(even.points, even.normals, even.friction, squeeze)
    solution = solve(uneven, wrench, squeeze)
    open_ = np.asarray(solution.verdict) == Verdict.FEASIBLE
    assert open_.sum() > 10
    least, expected = (np.asarray(jaxgrasp.least_squeeze(grasp, wrench)) for grasp in (uneven, even))
    np.testing.assert_allclose(least[open_], expected[open_], rtol=1e-6)
    closest = jaxgrasp.reachable_wrench(uneven, wrench)
    assert np.all(np.asarray(closest.distance)[open_] == 0)
    np.testing.assert_array_equal(np.asarray(closest.forces)[open_], np.asarray(solution.forces)[open_])
    assert "largest force" in str(solution[int(np.flatnonzero(open_)[0])])


@pytest.mark.parametrize("small", [1e-300, 1e-306, 1e-307, 2.3e-308, 2e-310])
def test_a_squeeze_of_next_to_nothing_proves_nothing_false(small):
    """Beside other squeezes the smallest normal numbers vanish too: data that cannot be used, or an answer."""
    grasp, wrench = sampled(3, seed=7)
    is_feasible = exists(grasp, wrench)
    squeeze = np.asarray(grasp.squeeze).copy()
    squeeze[:, 0] = small
    solution = jax.device_get(solve(Grasp(grasp.points, grasp.normals, grasp.friction, squeeze), wrench, squeeze))
    assert is_feasible.any() and not (solution.verdict[is_feasible] == Verdict.INFEASIBLE).any()
    invalid = solution.verdict == Verdict.INVALID_DATA
    assert invalid.all() if small < 2.3e-308 else not invalid.any() if small >= 1e-306 else True
