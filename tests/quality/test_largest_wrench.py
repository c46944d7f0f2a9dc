"""The largest wrench: between Clarabel's answers, known ones, laws, and derivatives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxgrasp
from jaxgrasp import Grasp, GraspError
from jaxgrasp.quality import largest_wrench, largest_wrench_at
from jaxgrasp.testing import problems as P
from tests.quality import known

BOUNDS = ("l1", "linf")


def by_clarabel(grasp: Grasp, task: np.ndarray, bound: str) -> float:
    """Solve the cone program on the forces themselves: alpha, then (force, moment) of each contact."""
    clarabel = pytest.importorskip("clarabel")
    sparse = pytest.importorskip("scipy.sparse")
    n = len(grasp.friction)
    torsion = np.zeros(n) if grasp.torsion is None else np.asarray(grasp.torsion)
    columns = 1 + 4 * n
    balance = np.zeros((6, columns))
    balance[:, 0] = -task
    bounds, cones, sizes = np.zeros((n, columns)), [], []
    for i in range(n):
        rows = slice(1 + 4 * i, 4 + 4 * i)
        point, normal = np.asarray(grasp.points[i]), np.asarray(grasp.normals[i])
        balance[:3, rows], balance[3:, rows] = np.eye(3), np.cross(point, np.eye(3)).T
        balance[3:, 4 + 4 * i] = normal * (torsion[i] > 0)
        bounds[i, rows] = normal
        cone = np.zeros((5, columns))
        cone[0, rows] = -normal
        cone[1:4, rows] = -(np.eye(3) - np.outer(normal, normal)) / grasp.friction[i]
        cone[4, 4 + 4 * i] = -1 / torsion[i] if torsion[i] > 0 else -1
        cones.append(cone)
        sizes.append(clarabel.SecondOrderConeT(5))
    if bound == "l1":
        bounds = bounds.sum(0, keepdims=True)
    matrix = sparse.csc_matrix(np.vstack([balance, bounds, *cones]))
    right = np.concatenate([np.zeros(6), np.ones(len(bounds)), np.zeros(5 * n)])
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_gap_rel = settings.tol_gap_abs = settings.tol_feas = 1e-10
    shapes = [clarabel.ZeroConeT(6), clarabel.NonnegativeConeT(len(bounds)), *sizes]
    nothing = sparse.csc_matrix((columns, columns))
    solved = clarabel.DefaultSolver(nothing, -np.eye(columns)[0], matrix, right, shapes, settings).solve()
    return solved.x[0]


@pytest.mark.parametrize("bound", BOUNDS)
@pytest.mark.parametrize("torsion", [False, True])
@pytest.mark.parametrize("n", [pytest.param(3, marks=pytest.mark.slow), 6])
def test_it_is_what_another_solver_finds(n, torsion, bound):
    grasp, task = known.ordinary(n, 6, torsion=torsion), P.problems("ordinary", n, 6, 1).wrench
    margin = largest_wrench(grasp, task, bound)
    expected = [by_clarabel(known.single(grasp, i), task[i], bound) for i in range(6)]
    np.testing.assert_allclose(margin.upper, expected, rtol=2e-6)
    assert (margin.lower >= (1 - 1.01e-6) * margin.upper).all()


@pytest.mark.parametrize("bound", BOUNDS)
def test_both_bounds_are_proven_by_forces_and_by_a_twist(bound):
    grasp, task = known.ordinary(5, 10, torsion=True), P.problems("ordinary", 5, 10, 1).wrench
    margin = largest_wrench(grasp, task, bound)
    moment = np.cross(grasp.points, margin.forces).sum(1) + (margin.moments[..., None] * grasp.normals).sum(1)
    exerted = np.concatenate([margin.forces.sum(1), moment], 1)
    size = np.linalg.norm(margin.lower[:, None] * task, axis=1, keepdims=True)
    assert (np.abs(exerted - margin.lower[:, None] * task) < 1e-9 * size).all()
    press = np.sum(margin.forces * grasp.normals, -1)
    across = np.linalg.norm(margin.forces - press[..., None] * grasp.normals, axis=-1)
    assert (np.hypot(across / grasp.friction, margin.moments / grasp.torsion) <= press * (1 + 1e-12) + 1e-15).all()
    used = press.sum(1) if bound == "l1" else press.max(1)
    assert (used <= 1 + 1e-12).all()
    np.testing.assert_allclose(np.sum(margin.twist * task, 1), 1, rtol=1e-9)
    linear, angular = margin.twist[:, None, :3], margin.twist[:, None, 3:]
    velocity = linear + np.cross(angular, grasp.points)
    along = np.sum(velocity * grasp.normals, -1)
    slide = grasp.friction * np.linalg.norm(velocity - along[..., None] * grasp.normals, axis=-1)
    heights = np.maximum(along + np.hypot(slide, grasp.torsion * np.sum(angular * grasp.normals, -1)), 0)
    np.testing.assert_allclose(heights.max(1) if bound == "l1" else heights.sum(1), margin.upper, rtol=1e-9)


def test_two_fingers_lift_by_friction():
    """A pair that squeezes with 1 N each lifts 2 mu N; with 1 N in all mu N; and turns nothing about its line."""
    pair, lift, turn = known.two_fingers(None), np.eye(6)[2], np.eye(6)[3]
    np.testing.assert_allclose(largest_wrench(pair, lift).upper, 1.0, rtol=1e-9)
    np.testing.assert_allclose(largest_wrench(pair, lift, "l1").upper, 0.5, rtol=1e-9)
    nothing = largest_wrench(pair, turn)
    assert nothing.lower == 0 and nothing.upper < 1e-12
    np.testing.assert_allclose(largest_wrench(known.two_fingers(0.01), turn).upper, 0.02, rtol=1e-9)


@pytest.mark.slow
def test_with_a_bounded_sum_it_is_one_over_the_least_squeeze():
    problem = P.problems("ordinary", 5, 20, 1)
    grasp = Grasp(problem.points, problem.normals, problem.friction, problem.squeeze)
    margin = largest_wrench(grasp, problem.wrench, "l1")
    np.testing.assert_allclose(1 / margin.upper, jaxgrasp.least_squeeze(grasp, problem.wrench), rtol=2e-6)


@pytest.mark.parametrize("bound", [pytest.param("l1", marks=pytest.mark.slow), "linf"])
def test_laws(bound):
    grasp, task = known.ordinary(5, 6), P.problems("ordinary", 5, 6, 1).wrench
    plain = largest_wrench(grasp, task, bound)
    turned, rotation = known.turned(grasp)
    as_turned = np.concatenate([task[:, :3] @ rotation.T, task[:, 3:] @ rotation.T], 1)
    shift = np.array([0.3, -0.2, 0.5])
    as_moved = np.concatenate([task[:, :3], task[:, 3:] + np.cross(shift, task[:, :3])], 1)
    for other_grasp, load, factor in (
        (turned, as_turned, 1),
        (known.changed(grasp, points=grasp.points + shift), as_moved, 1),
        (known.padded(grasp), task, 1),
        (grasp, 3 * task, 1 / 3),
    ):
        np.testing.assert_allclose(largest_wrench(other_grasp, load, bound).upper, factor * plain.upper, rtol=2e-6)
    rough = largest_wrench(known.changed(grasp, friction=1.3 * grasp.friction), task, bound)
    assert (rough.upper >= plain.lower).all()
    inner = largest_wrench(grasp, task, bound, sides=6)
    assert (inner.lower <= plain.upper).all() and (inner.upper > 0.7 * plain.lower).all()


def test_derivatives_are_those_of_the_value():
    grasp, task = known.ordinary(5, 6), P.problems("ordinary", 5, 6, 1).wrench
    margin = largest_wrench(grasp, task, tol=1e-10)
    points, friction = (jnp.asarray(getattr(grasp, name)) for name in ("points", "friction"))
    rng = np.random.default_rng(0)
    tangent = tuple(scale * rng.normal(size=a.shape) for a, scale in ((points, 0.03), (friction, 1), (task, 1)))

    @jax.jit
    def of(points, friction, task):
        grown = known.changed(known.of_jax(grasp), points=points, friction=friction)
        return largest_wrench_at(grown, task, margin)

    value, forward = jax.jvp(of, (points, friction, jnp.asarray(task)), tangent)
    np.testing.assert_allclose(value, margin.upper, rtol=1e-8)
    reverse = jax.grad(lambda *a: jnp.sum(of(*a)), argnums=(0, 1, 2))(points, friction, jnp.asarray(task))
    product = sum(np.sum(np.asarray(a) * b, tuple(range(1, b.ndim))) for a, b in zip(reverse, tangent))
    np.testing.assert_allclose(product, forward, rtol=1e-10)
    step = 1e-4
    ends = []
    for sign in (step, -step):
        moved_arrays = [np.asarray(a) + sign * b for a, b in zip((points, friction, task), tangent)]
        moved_grasp = known.changed(grasp, points=moved_arrays[0], friction=moved_arrays[1])
        ends.append(largest_wrench(moved_grasp, moved_arrays[2], tol=1e-10).upper)
    np.testing.assert_allclose(forward, (ends[0] - ends[1]) / (2 * step), rtol=1e-4)


@pytest.mark.parametrize("bound", BOUNDS)
def test_slopes_are_those_of_another_solver(bound):
    """Differences of Clarabel's own values; nothing of ours but the derivative."""
    grasp, task = known.ordinary(5, 4), P.problems("ordinary", 5, 4, 1).wrench
    margin = largest_wrench(grasp, task, bound, tol=1e-9)
    points, friction = (jnp.asarray(getattr(grasp, name)) for name in ("points", "friction"))
    rng = np.random.default_rng(3)
    tangent = tuple(scale * rng.normal(size=a.shape) for a, scale in ((points, 0.03), (friction, 1), (task, 1)))

    def of(points, friction, task):
        return largest_wrench_at(known.changed(known.of_jax(grasp), points=points, friction=friction), task, margin)

    _, forward = jax.jvp(of, (points, friction, jnp.asarray(task)), tangent)
    step = 1e-4

    def theirs(i: int, t: float) -> float:
        moved_arrays = [np.asarray(a) + t * b for a, b in zip((points, friction, task), tangent)]
        return by_clarabel(
            known.single(known.changed(grasp, points=moved_arrays[0], friction=moved_arrays[1]), i),
            moved_arrays[2][i],
            bound,
        )

    slopes = [(theirs(i, step) - theirs(i, -step)) / (2 * step) for i in range(4)]
    np.testing.assert_allclose(forward, slopes, rtol=2e-3)


@pytest.mark.parametrize("bound", BOUNDS)
def test_inside_jit_vmap_and_grad_it_is_the_same(bound):
    grasp, task = known.ordinary(5, 6, torsion=True), P.problems("ordinary", 5, 6, 1).wrench
    plain = largest_wrench(grasp, task, bound)
    inside = jax.jit(jax.vmap(lambda g, t: largest_wrench(g, t, bound)))(known.of_jax(grasp), jnp.asarray(task))
    for name in plain._fields:
        np.testing.assert_allclose(getattr(inside, name), getattr(plain, name), rtol=1e-9, atol=1e-9)

    def upper(points, task):
        return jnp.sum(largest_wrench(known.changed(known.of_jax(grasp), points=points), task, bound).upper)

    def beside(points, task):
        return jnp.sum(largest_wrench_at(known.changed(known.of_jax(grasp), points=points), task, plain))

    arrays = jnp.asarray(grasp.points), jnp.asarray(task)
    for inner, outer in zip(jax.jit(jax.grad(upper, (0, 1)))(*arrays), jax.grad(beside, (0, 1))(*arrays)):
        np.testing.assert_allclose(inner, outer, rtol=1e-6, atol=1e-8 * np.abs(outer).max())


def test_inside_jit_a_task_that_cannot_be_used_has_no_answer():
    grasp = known.ordinary(5, 6, torsion=True)
    tasks = P.problems("ordinary", 5, 6, 1).wrench.copy()
    tasks[1], tasks[2] = 0, np.nan
    margin = jax.jit(largest_wrench)(known.of_jax(grasp), jnp.asarray(tasks))
    assert (
        np.isnan(margin.upper).tolist() == np.isnan(margin.lower).tolist() == [False, True, True, False, False, False]
    )


@pytest.mark.usefixtures("unchecked")
def test_bad_tasks_are_named():
    grasp = known.triangle()
    with pytest.raises(GraspError, match=r"task is .*not all zero"):
        largest_wrench(grasp, np.zeros(6))
    with pytest.raises(GraspError, match=r"task\[1\] is .*expected six finite numbers"):
        largest_wrench(known.ordinary(3, 2), np.array([[1.0, 0, 0, 0, 0, 0], [np.inf, 0, 0, 0, 0, 0]]))
    with pytest.raises(ValueError, match=r"task has shape \(5,\): expected \(..., 6\)"):
        largest_wrench(grasp, np.ones(5))


@pytest.mark.parametrize("bound", BOUNDS)
def test_the_bounds_are_in_order_however_badly_the_grasp_is_conditioned(bound):
    """Near a line, far from the frame's origin: there a wrench that is missed by rounding alone is worth much."""
    problem = P.problems("combined", 3, 1500, seed=7)
    arrays = (problem.points, problem.normals, problem.friction, problem.squeeze, problem.wrench)
    *fields, task = (array[20:40] for array in arrays)
    margin = largest_wrench(Grasp(*fields), task, bound)
    assert (margin.lower <= margin.upper).all() and (margin.lower > 0).any()
