"""Laws of every method of the literature: equilibrium, friction, invariance, padding, statuses, errors."""

import functools

import numpy as np
import pytest

import jaxgrasp
from jaxgrasp import Grasp, GraspError, Limits
from jaxgrasp.literature import LITERATURE_METHODS, MethodAnswer, MethodStatus
from jaxgrasp.testing import problems as P

COUNT, N = 12, 5
MOST = 300.0
"""Largest normal force [N]: above what any problem here needs."""
PRECISION = {"buss": 1e-6}
"""Relative precision of forces: a flow ends where its value no longer falls, and that is flat at the minimum."""
EVERY_METHOD = pytest.mark.parametrize("name", LITERATURE_METHODS)


def grasp_of(problem: P.Problems, **changes) -> Grasp:
    fields = {name: getattr(problem, name) for name in ("points", "normals", "friction", "squeeze")}
    return Grasp(**(fields | changes))


def solve(name: str, grasp: Grasp, wrench: np.ndarray, **options) -> MethodAnswer:
    limits = Limits(normal_max=np.full(np.shape(grasp.friction)[-1], MOST))
    return LITERATURE_METHODS[name](grasp, wrench, limits, **options)


def padded(problem: P.Problems, n: int = N) -> Grasp:
    """Return a grasp with absent contacts that hold nothing but NaN, so that fewer shapes are compiled."""
    more = n - problem.friction.shape[1]
    arrays = [np.concatenate([x, np.full_like(x[:, :1].repeat(more, 1), np.nan)], 1) for x in problem[1:5]]
    return Grasp(*arrays, np.broadcast_to((np.arange(n) < n - more).astype(float), (len(problem.wrench), n)))


@functools.cache
def solved(name: str, kind: str = "ordinary", n: int = N) -> tuple[P.Problems, MethodAnswer]:
    problem = P.problems(kind, n, COUNT, seed=5)
    if n == N:
        return problem, solve(name, grasp_of(problem), problem.wrench)
    answer = solve(name, padded(problem), problem.wrench)
    assert (answer.forces[:, n:] == 0).all()
    return problem, MethodAnswer(answer.forces[:, :n], answer.status, answer.objective, answer.iterations)


def off_balance(problem: P.Problems, forces: np.ndarray) -> np.ndarray:
    """Compute |w - G f| relative to what rounding of its terms allows, torques about the contacts' middle."""
    middle = problem.points.mean(1)
    arms = problem.points - middle[:, None]
    about = problem.wrench[:, 3:] - np.cross(middle, problem.wrench[:, :3])
    residual = np.concatenate(
        [problem.wrench[:, :3] - forces.sum(1), (about - np.cross(arms, forces).sum(1)) / 0.05], -1
    )
    size = np.linalg.norm(problem.wrench, axis=-1) + np.abs(forces).sum((1, 2)) + problem.squeeze.sum(-1)
    return np.linalg.norm(residual, axis=-1) / size


def beyond_cone(problem: P.Problems, forces: np.ndarray) -> np.ndarray:
    """Return how far the worst force is outside its cone, relative to the largest force or squeeze."""
    along = np.sum(forces * problem.normals, -1)
    across = np.linalg.norm(forces - along[..., None] * problem.normals, axis=-1)
    return np.max(across - problem.friction * along, -1) / np.maximum(
        np.abs(forces).max((1, 2)), problem.squeeze.max(-1)
    )


@EVERY_METHOD
@pytest.mark.parametrize("n", [3, 5])
def test_solved_forces_balance_inside_the_cones(name, n):
    problem, answer = solved(name, n=n)
    good = answer.status == MethodStatus.SOLVED
    assert good.any() and np.isfinite(answer.forces).all() and np.isfinite(answer.objective).all()
    assert off_balance(problem, answer.forces)[good].max() < 1e-12
    assert beyond_cone(problem, answer.forces)[good].max() < 1e-7


@EVERY_METHOD
def test_the_order_of_contacts_does_not_matter(name):
    """Forces where the best ones are unique; the measure always."""
    problem, answer = solved(name)
    order = np.random.default_rng(0).permutation(N)
    turned = Grasp(*(np.ascontiguousarray(x[:, order]) for x in problem[1:5]))
    other_answer = solve(name, turned, problem.wrench)
    np.testing.assert_array_equal(other_answer.status, answer.status)
    np.testing.assert_allclose(other_answer.objective, answer.objective, rtol=1e-6, atol=1e-9)


@EVERY_METHOD
def test_a_batch_is_its_problems_and_keeps_its_axes(name):
    problem, answer = solved(name)
    close = {"rtol": PRECISION.get(name, 1e-9), "atol": 10 * PRECISION.get(name, 1e-9)}
    folded = Grasp(*(x.reshape(3, 4, *x.shape[1:]) for x in problem[1:5]))
    other_answer = solve(name, folded, problem.wrench.reshape(3, 4, 6))
    assert other_answer.forces.shape == (3, 4, N, 3)
    np.testing.assert_allclose(other_answer.forces.reshape(COUNT, N, 3), answer.forces, **close)
    single_answer = solve(name, Grasp(*(x[3] for x in problem[1:5])), problem.wrench[3])
    assert single_answer.status.shape == () and single_answer.status == answer.status[3]
    np.testing.assert_allclose(single_answer.forces, answer.forces[3], **close)
    shared = solve(name, Grasp(*(x[3] for x in problem[1:5])), problem.wrench)
    np.testing.assert_allclose(shared.forces[3], answer.forces[3], **close)


@EVERY_METHOD
def test_absent_contacts_carry_nothing_whatever_they_hold(name):
    problem, answer = solved(name)
    close = {"rtol": PRECISION.get(name, 1e-7), "atol": 10 * PRECISION.get(name, 1e-7)}
    other_answer = solve(name, padded(problem, N + 2), problem.wrench)
    np.testing.assert_array_equal(other_answer.status, answer.status)
    np.testing.assert_allclose(other_answer.forces[:, :N], answer.forces, **close)
    assert (other_answer.forces[:, N:] == 0).all()


@EVERY_METHOD
def test_an_empty_grasp_balances_nothing_only(name):
    problem = P.problems("ordinary", N, COUNT, 0)
    loads = np.arange(COUNT) % 2
    answer = solve(name, grasp_of(problem, present=np.zeros((COUNT, N))), loads[:, None] * problem.wrench)
    np.testing.assert_array_equal(answer.status, np.where(loads, MethodStatus.INFEASIBLE, MethodStatus.SOLVED))
    assert (answer.forces == 0).all()
    empty = solve(name, Grasp(*(x[:0] for x in P.problems("ordinary", 3, 2, 0)[1:5])), np.zeros((0, 6)))
    assert empty.forces.shape == (0, 3, 3)


@EVERY_METHOD
@pytest.mark.parametrize("n", [1, 2, 3, 5])
def test_what_cannot_be_held_is_never_solved(name, n):
    problem, answer = solved(name, "infeasible", n)
    allowed = {MethodStatus.INFEASIBLE, MethodStatus.OUTSIDE_CONES}
    assert set(answer.status.tolist()) <= allowed
    assert (answer.forces[answer.status == MethodStatus.INFEASIBLE] == 0).all()


@EVERY_METHOD
@pytest.mark.parametrize("kind", ["coincident_all", "zero_friction", "zero_wrench", "near_collinear"])
def test_awkward_grasps_are_named_not_raised(name, kind):
    problem, answer = solved(name, kind, 4)
    assert all(np.isfinite(x).all() for x in (answer.forces, answer.objective))
    good = answer.status == MethodStatus.SOLVED
    assert (off_balance(problem, answer.forces)[good] < 1e-10).all()
    assert (beyond_cone(problem, answer.forces)[good] < 1e-6).all()


@EVERY_METHOD
@pytest.mark.parametrize("n", [1, 2])
def test_a_torque_about_the_line_of_few_contacts_is_out_of_reach(name, n):
    problem = P.problems("ordinary", n, COUNT, seed=2)
    line = problem.points[:, -1] - problem.points[:, 0] if n == 2 else np.ones((COUNT, 3))
    wrench = np.concatenate([np.zeros((COUNT, 3)), P.unit(line)], -1)
    answer = solve(name, padded(problem), wrench)
    assert (answer.status == MethodStatus.INFEASIBLE).all()


BAD = {
    "normals": (lambda p: {"normals": np.where(np.arange(N)[:, None] == 2, 2.0, p.normals)}, r"normals\[0, 2\]"),
    "friction": (lambda p: {"friction": -p.friction}, r"friction\[0, 0\] is -0\."),
    "squeeze": (lambda p: {"squeeze": np.full_like(p.squeeze, np.inf)}, r"squeeze\[0, 0\] is inf"),
    "points": (lambda p: {"points": p.points[:, :3]}, "normals is an array of shape"),
}


@EVERY_METHOD
@pytest.mark.parametrize("field", BAD)
def test_bad_grasps_raise_by_name(name, field, unchecked):
    problem = P.problems("ordinary", N, 2, seed=0)
    change, message = BAD[field]
    with pytest.raises(GraspError, match=message):
        solve(name, grasp_of(problem, **change(problem)), problem.wrench)


@EVERY_METHOD
def test_bad_wrenches_and_soft_fingers_raise(name, unchecked):
    problem = P.problems("ordinary", N, 2, seed=0)
    broken = np.where(np.arange(6) == 4, np.nan, problem.wrench)
    with pytest.raises(GraspError, match=r"wrench\[0, 4\] is nan: expected a finite number"):
        solve(name, grasp_of(problem), broken)
    with pytest.raises(ValueError, match=r"wrench has shape \(2, 5\): expected \(..., 6\)"):
        solve(name, grasp_of(problem), problem.wrench[:, :5])
    with pytest.raises(ValueError, match="leading axes do not broadcast"):
        solve(name, grasp_of(problem), np.zeros((3, 6)))
    with pytest.raises(ValueError, match=r"torsion\[.*\] is .*: expected 0"):
        solve(name, grasp_of(problem, torsion=np.full((2, N), 0.01)), problem.wrench)


@EVERY_METHOD
def test_bad_problems_can_be_marked_instead(name):
    problem, answer = solved(name)
    friction, wrench = problem.friction.copy(), problem.wrench.copy()
    friction[1, 2], wrench[4, 0] = np.nan, np.inf
    other_answer = solve(name, grasp_of(problem, friction=friction), wrench, throw=False)
    invalid = np.isin(np.arange(COUNT), (1, 4))
    np.testing.assert_array_equal(other_answer.status == MethodStatus.INVALID_DATA, invalid)
    assert (other_answer.forces[invalid] == 0).all()
    close = PRECISION.get(name, 1e-9)
    np.testing.assert_allclose(other_answer.forces[~invalid], answer.forces[~invalid], rtol=close, atol=10 * close)


def test_statuses_are_sentences_with_stable_codes():
    assert [int(status) for status in MethodStatus] == list(range(6))
    assert all(status.advice.endswith(".") for status in MethodStatus)


def test_methods_are_public_by_their_names():
    for name, method in LITERATURE_METHODS.items():
        assert getattr(jaxgrasp.literature, name) is method.solve
