"""Objects that a guide holds: only the wrench's work along its free twists is balanced."""

import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
import pytest

import jaxgrasp
from benchmarks import laws
from jaxgrasp import Grasp, Verdict
from jaxgrasp.testing import problems as P
from jaxgrasp.testing import references as R

COUNT, N = 64, 4
SHARINGS = ("squeeze", "uniform")
KINDS = ("ordinary", "low_friction", "zero_friction", "some_zero_squeeze", "wide_squeeze", "far_frame", "scales")
METHODS = {"closed": jaxgrasp.closed_form, "optimum": jaxgrasp.constrained_optimum}
UP = np.eye(6)[:, 2:3]


def grasp_of(problem: P.Problems) -> Grasp:
    return Grasp(problem.points, problem.normals, problem.friction, problem.squeeze)


def twists(problem: P.Problems, k: int, seed: int) -> np.ndarray:
    """Return random free twists ``(COUNT, 6, k)``, linear and angular parts of one size about the contacts' middle."""
    linear, angular = np.random.default_rng(seed).normal(size=(2, len(problem.points), k, 3))
    middle = problem.points.mean(1)
    radius = np.linalg.norm(problem.points - middle[:, None], axis=-1).max(-1)
    angular = angular / np.where(radius > 0, radius, 1)[:, None, None]
    linear = linear - np.cross(angular, middle[:, None])
    return np.concatenate([linear, angular], -1).swapaxes(1, 2)


def outside_span(vectors: np.ndarray, free: np.ndarray, problem: P.Problems) -> np.ndarray:
    """Return the relative length of twists outside the free ones, with lengths in units of the contacts' radius."""
    centred_problem = R.centred(problem, problem.weights("uniform"))
    columns = np.stack(
        [np.asarray(centred_problem.scaled_twist(free[..., j]), float) for j in range(free.shape[-1])], -1
    )
    basis = np.linalg.qr(columns / np.linalg.norm(columns, axis=1, keepdims=True))[0]
    twists = np.asarray(centred_problem.scaled_twist(vectors), float)
    residual = twists - np.einsum("bik,bjk,bj->bi", basis, basis, twists)
    size = np.linalg.norm(twists, axis=-1)
    return np.linalg.norm(residual, axis=-1) / np.where(size > 0, size, 1)


def unbalanced(problem: P.Problems, free: np.ndarray, forces: np.ndarray) -> np.ndarray:
    """Compute the unbalanced work along the free twists, relative to the work of the load."""
    residual = problem.wrench - P.exact_wrench(problem.points, forces)
    work = np.abs(np.einsum("bik,bi->bk", free, residual)).max(-1)
    middle = problem.points.mean(1)
    arms = np.linalg.norm(problem.points - middle[:, None], axis=-1).max(-1)
    reach = np.linalg.norm(free[:, :3] + np.cross(free[:, 3:], middle[:, :, None], axis=1), axis=1)
    reach = (reach + arms[:, None] * np.linalg.norm(free[:, 3:], axis=1)).max(-1)
    size = (
        np.linalg.norm(forces, axis=-1).sum(-1)
        + problem.squeeze.sum(-1)
        + np.linalg.norm(problem.wrench[:, :3], axis=-1)
    )
    return work / (reach * size)


@pytest.mark.parametrize("sharing", SHARINGS)
@pytest.mark.parametrize("k", [pytest.param(1, marks=pytest.mark.slow), 4])
@pytest.mark.parametrize("kind", KINDS)
def test_answers_are_proven_by_weak_duality(kind, k, sharing):
    """Allowed forces that balance the free twists, and a multiplier among them that bounds the objective from below."""
    problem = P.problems(kind, N, COUNT, seed=1)
    free, weights = twists(problem, k, seed=2), problem.weights(sharing)
    solution = jax.device_get(jaxgrasp.constrained_optimum(grasp_of(problem), problem.wrench, weights, free=free))
    # Along the free twists this wrench works as the one that was asked for.
    exerted = problem._replace(wrench=P.exact_wrench(problem.points, solution.forces))
    held = laws.hold(exerted, weights, solution)
    assert not {name for name in ("gap", "force outside its cone") if held.broken[name].any()}
    assert held.solved.mean() > 0.3
    assert (unbalanced(problem, free, solution.forces)[held.solved] < 1e-11).all()
    assert (outside_span(solution.multiplier, free, problem)[held.solved] < 1e-9).all()
    proofs = laws.hold(problem, weights, solution)
    assert not proofs.broken["proof of nothing"].any()
    assert (outside_span(solution.certificate, free, problem)[held.hopeless] < 1e-9).all()
    assert (held.solved | held.hopeless | (solution.verdict == Verdict.NO_CONTACTS)).all()


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["ordinary", "infeasible", "near_collinear"])
def test_all_six_twists_are_an_object_that_no_guide_holds(kind):
    problem = P.problems(kind, N, COUNT, seed=3)
    for method in METHODS.values():
        free = jax.device_get(method(grasp_of(problem), problem.wrench))
        held = jax.device_get(method(grasp_of(problem), problem.wrench, free=twists(problem, 6, seed=4)))
        np.testing.assert_array_equal(held.verdict, free.verdict)
        solved = free.verdict <= Verdict.OUTSIDE_CONES
        scale = np.abs(free.forces[solved]).max((1, 2))[:, None, None]
        np.testing.assert_allclose(held.forces[solved] / scale, free.forces[solved] / scale, atol=1e-7)
        np.testing.assert_array_equal(held.rank, free.rank)


def test_a_vertical_slider_by_hand():
    """Method B moves every force along the slider, by its squeeze."""
    problem = P.problems("ordinary", N, COUNT, seed=5)
    solution = jaxgrasp.closed_form(grasp_of(problem), problem.wrench, free=UP)
    s = problem.squeeze
    missing = problem.wrench[:, 2] - np.sum(s * problem.normals[..., 2], -1)
    expected = s[..., None] * problem.normals
    expected[..., 2] += s * (missing / s.sum(-1))[:, None]
    np.testing.assert_allclose(solution.forces, expected, rtol=1e-12, atol=1e-12 * np.abs(expected).max())
    np.testing.assert_allclose(solution.multiplier[:, 2], missing / s.sum(-1), rtol=1e-10)
    np.testing.assert_allclose(np.delete(solution.multiplier, 2, 1), 0, atol=1e-12)
    assert (solution.rank == 1).all()


@pytest.mark.slow
def test_only_the_span_of_the_twists_counts():
    problem = P.problems("ordinary", N, COUNT, seed=6)
    free = twists(problem, 3, seed=7)
    mixed = free @ np.array([[2.0, 1, 0, 3], [0, 1e3, 1, 1e3], [1, 0, 1e-3, 1]])
    by_free, by_mixed = (jaxgrasp.constrained_optimum(grasp_of(problem), problem.wrench, free=f) for f in (free, mixed))
    np.testing.assert_allclose(by_free.forces, by_mixed.forces, atol=1e-9 * float(jnp.abs(by_free.forces).max()))
    assert (by_mixed.rank == 3).all()


@pytest.mark.parametrize("distance", [1.0, 10.0, 100.0])
def test_a_twist_given_twice_is_one_however_far_the_frame(distance):
    """A hinge among the contacts, written about an origin far away, where its digits are few."""
    problem = P.problems("ordinary", N, COUNT, seed=21)
    middle = problem.points.mean(1)
    away = distance * P.unit(np.random.default_rng(22).normal(size=(COUNT, 3)))
    points = problem.points - middle[:, None] + away[:, None]
    forces = problem.wrench[:, :3]
    torque = problem.wrench[:, 3:] + np.cross(away - middle, forces)
    axis = P.unit(np.random.default_rng(23).normal(size=(COUNT, 3)))
    hinge = np.concatenate([np.cross(away, axis), axis], -1)[..., None]
    grasp = Grasp(points, problem.normals, problem.friction, problem.squeeze)
    wrench = np.concatenate([forces, torque], -1)
    once, twice = (
        jax.device_get(jaxgrasp.closed_form(grasp, wrench, free=f))
        for f in (hinge, np.concatenate([hinge, 3.3 * hinge], -1))
    )
    assert (once.rank == 1).all() and (twice.rank == 1).all()
    np.testing.assert_array_equal(once.verdict, twice.verdict)
    np.testing.assert_allclose(twice.forces, once.forces, atol=1e-8 * np.abs(once.forces).max())


@pytest.mark.slow
def test_a_guide_never_makes_it_dearer():
    """Each twist that is taken away is one condition less."""
    problem = P.problems("ordinary", N, COUNT, seed=8)
    free = twists(problem, 6, seed=9)
    solutions = [
        jaxgrasp.constrained_optimum(grasp_of(problem), problem.wrench, free=free[..., :k]) for k in (6, 4, 2, 1)
    ]
    for looser, tighter in zip(solutions[1:], solutions, strict=False):
        assert ((tighter.verdict == Verdict.INFEASIBLE) | (looser.objective <= tighter.objective * (1 + 1e-9))).all()


@pytest.mark.slow
def test_a_rail_without_friction_cannot_be_climbed():
    """Two frictionless fingers level with each other press; nothing lifts."""
    points, normals = np.array([[0.02, 0, 0], [-0.02, 0, 0]]), np.array([[-1.0, 0, 0], [1, 0, 0]])
    grasp = Grasp(points, normals, np.zeros(2), np.array([3.0, 3.0]))
    weight = np.array([0, 0, 2.0, 0, 0, 0])
    solution = jaxgrasp.constrained_optimum(grasp, weight, free=UP)
    assert int(solution.verdict) == Verdict.INFEASIBLE
    np.testing.assert_allclose(solution.certificate / solution.certificate[2], np.eye(6)[2], atol=1e-12)
    assert jaxgrasp.verify_certificate(grasp, weight, solution.certificate) > 1e6
    # With friction it does, and the guide carries the torque that two hard fingers could not resist.
    rough = Grasp(points, normals, np.full(2, 0.5), np.array([3.0, 3.0]))
    twisted = weight + np.array([1.0, 2, 0, 0.1, 0.2, 0.3])
    held = jaxgrasp.constrained_optimum(rough, twisted, free=UP)
    assert int(held.verdict) <= Verdict.OPTIMAL and float(held.forces[:, 2].sum()) == pytest.approx(2.0)


@pytest.mark.slow
def test_a_twist_that_no_contact_resists_is_named():
    """A hinge through the only contact: nothing turns the object about it."""
    grasp = Grasp(np.zeros((1, 3)), np.array([[0.0, 0, 1]]), np.ones(1), np.ones(1))
    hinge = np.eye(6)[:, 3:4]
    turned = jaxgrasp.constrained_optimum(grasp, np.eye(6)[3], free=hinge)
    assert int(turned.verdict) == Verdict.INFEASIBLE and int(turned.rank) == 0
    still = jaxgrasp.constrained_optimum(grasp, np.eye(6)[0], free=hinge)
    assert int(still.verdict) == Verdict.CLOSED_FORM_OPTIMAL
    np.testing.assert_allclose(still.forces, [[0, 0, 1]])


@pytest.mark.slow
def test_what_a_rail_leaves_to_fall():
    """The closest wrench that the contacts exert along the free twists, against least squares over fine pyramids."""
    nnls = pytest.importorskip("scipy.optimize").nnls
    problem = P.problems("infeasible", 2, COUNT, seed=18)
    free = twists(problem, 3, seed=19)
    root = np.random.default_rng(20).normal(size=(COUNT, 6, 6)) * [1, 1, 1, 0.03, 0.03, 0.03]
    inertia = root.swapaxes(1, 2) @ root + np.diag([1, 1, 1, 1e-3, 1e-3, 1e-3])
    reachable = jaxgrasp.reachable_wrench(grasp_of(problem), problem.wrench, inertia=inertia, free=free)
    reachable = jax.device_get(reachable)
    assert set(reachable.verdict.tolist()) <= {Verdict.CLOSED_FORM_OPTIMAL, Verdict.OPTIMAL, Verdict.INFEASIBLE}
    residual = problem.wrench - reachable.wrench
    # What is missed is the work along the free twists, done by the shortest wrench.
    exerted = P.exact_wrench(problem.points, reachable.forces)
    size = np.abs(np.einsum("bik,bi->bk", free, problem.wrench)).max(-1)[:, None]
    apart = np.einsum("bik,bi->bk", free, reachable.wrench - exerted) / size
    np.testing.assert_allclose(apart[reachable.verdict == Verdict.INFEASIBLE], 0, atol=1e-8)
    length = np.sqrt(np.einsum("bi,bij,bj->b", residual, np.linalg.inv(inertia), residual))
    np.testing.assert_allclose(reachable.distance, length, rtol=1e-6, atol=1e-9 * length.max())
    hopeless = np.flatnonzero(reachable.verdict == Verdict.INFEASIBLE)
    assert len(hopeless) > 20
    for i in hopeless:
        to_free = np.linalg.cholesky(np.linalg.inv(free[i].T @ inertia[i] @ free[i])).T @ free[i].T
        best = nnls(to_free @ edges(problem, i).T, to_free @ problem.wrench[i])[1]
        # A pyramid inside the cone exerts a little less than the cone does.
        assert best * 0.99 <= reachable.distance[i] <= best * (1 + 1e-9)


def edges(problem: P.Problems, i: int) -> np.ndarray:
    """Return the wrenches ``(2 * 90, 6)`` of forces along 90 edges of each contact's cone."""
    edge_list = []
    angles = np.linspace(0, 2 * np.pi, 90, endpoint=False)[:, None]
    for p, a, mu in zip(problem.points[i], problem.normals[i], problem.friction[i], strict=True):
        first, second = R.tangents(a)
        force = a + mu * (np.cos(angles) * first + np.sin(angles) * second)
        edge_list.append(np.concatenate([force, np.cross(p, force)], -1))
    return np.concatenate(edge_list)


@pytest.mark.slow
def test_a_solver_from_outside_agrees():
    problem = P.problems("ordinary", N, COUNT, seed=10)
    free = twists(problem, 2, seed=11)
    ours = jaxgrasp.constrained_optimum(grasp_of(problem), problem.wrench, free=free)
    solver = optx.LevenbergMarquardt(rtol=1e-10, atol=1e-10)
    theirs = jaxgrasp.constrained_optimum(grasp_of(problem), problem.wrench, free=free, solver=solver)
    is_solved_by_both = (theirs.verdict <= Verdict.OPTIMAL) & (ours.verdict <= Verdict.OPTIMAL)
    assert is_solved_by_both.mean() > 0.6
    np.testing.assert_allclose(theirs.objective[is_solved_by_both], ours.objective[is_solved_by_both], rtol=1e-7)


def answers(method: str, inputs):
    points, normals, friction, squeeze, wrench, free = inputs
    solution = METHODS[method](Grasp(points, normals, friction, squeeze), wrench, free=free)
    return solution.forces, solution.multiplier, solution.objective


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS)
def test_forward_reverse_and_differences_agree(method):
    problem = P.problems("ordinary", N, COUNT, seed=12)
    free = twists(problem, 2, seed=13)
    inputs = (problem.points, problem.normals, problem.friction, problem.squeeze, problem.wrench, free)
    rng = np.random.default_rng(14)
    moved = tuple(0.1 * np.abs(x).mean() * rng.normal(size=x.shape) for x in inputs)
    value = jax.jit(lambda *x: answers(method, x))
    out, forward = jax.jit(lambda x, t: jax.jvp(lambda *x: answers(method, x), x, t))(inputs, moved)
    pull = tuple(rng.normal(size=x.shape) for x in out)
    _, back = jax.vjp(lambda *x: answers(method, x), *inputs)
    by_reverse = sum(np.vdot(m, b) for m, b in zip(moved, back(tuple(map(jnp.asarray, pull))), strict=True))
    by_forward = sum(np.vdot(p, f) for p, f in zip(pull, forward, strict=True))
    assert by_reverse == pytest.approx(by_forward, rel=1e-9)
    step = 1e-6
    ahead, behind = (value(*(x + sign * step * m for x, m in zip(inputs, moved, strict=True))) for sign in (1, -1))
    for a, b, f in zip(ahead, behind, forward, strict=True):
        slope = (np.asarray(a) - np.asarray(b)) / (2 * step)
        apart = np.abs(slope - f).reshape(COUNT, -1).max(-1) / np.abs(slope).reshape(COUNT, -1).max(-1)
        # A cone that is met or left within the step has no one slope.
        assert np.quantile(apart, 0.9) < 1e-5


@pytest.mark.slow
def test_mapped_calls_are_the_batch():
    problem = P.problems("ordinary", N, COUNT, seed=15)
    grasp, free = grasp_of(problem), twists(problem, 2, seed=16)
    single_grasp = jax.tree.map(lambda x: x[0], grasp)

    def of_all(grasp, wrench, free):
        return jaxgrasp.constrained_optimum(grasp, wrench, free=free).forces

    batched, shared = (grasp, problem.wrench, free), (single_grasp, problem.wrench, UP)
    for arguments, axes in ((batched, (0, 0, 0)), (shared, (None, 0, None))):
        mapped = jax.jit(jax.vmap(of_all, axes))(*arguments)
        np.testing.assert_array_equal(mapped, jax.jit(of_all)(*arguments))
        # A plain call is another program, which rounds otherwise.
        plain = of_all(*arguments)
        np.testing.assert_allclose(mapped, plain, rtol=1e-12, atol=1e-13 * np.abs(plain).max())


def test_bad_twists_are_named(unchecked):
    problem = P.problems("ordinary", N, COUNT, seed=17)
    for bad in (np.zeros(6), np.zeros((6, 7)), np.zeros((3, 1))):
        with pytest.raises(ValueError, match=r"free has shape .*expected \(\.\.\., 6, k\), a column for each"):
            jaxgrasp.closed_form(grasp_of(problem), problem.wrench, free=bad)
    unknown = np.broadcast_to(UP, (COUNT, 6, 1)).copy()
    unknown[1, 0] = np.nan
    solution = jaxgrasp.constrained_optimum(grasp_of(problem), problem.wrench, free=unknown)
    assert int(solution.verdict[1]) == Verdict.INVALID_DATA and int(solution.verdict[0]) <= Verdict.INFEASIBLE
    assert np.isfinite(solution.forces).all()
