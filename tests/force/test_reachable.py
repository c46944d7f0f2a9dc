"""The closest reachable wrench: allowed, exerted by its forces, and at the distance that Clarabel finds."""

import jax
import numpy as np
import pytest

import jaxgrasp
from jaxgrasp import Grasp, Verdict
from jaxgrasp.force.reachable import nearest_wrench
from jaxgrasp.testing import problems as P
from jaxgrasp.testing import references as R

COUNT, N = 64, 3
DISTANCE = 1e-8
EVERYONE = np.ones((COUNT, N))


def nearest(problem: P.Problems, weights=None, present: np.ndarray = EVERYONE, inertia: np.ndarray | None = None):
    grasp = Grasp(problem.points, problem.normals, problem.friction, problem.squeeze, present)
    weights = problem.squeeze if weights is None else weights
    return jax.device_get(jaxgrasp.reachable_wrench(grasp, problem.wrench, weights, inertia=inertia))


def asking(kind: str, seed: int) -> P.Problems:
    """Return problems of a kind with random wrenches of about a third of the squeeze."""
    problem = P.problems(kind, N, COUNT, seed)
    middle = problem.points.mean(1)
    radius = np.linalg.norm(problem.points - middle[:, None], axis=-1).mean(-1)[:, None]
    force, torque = np.random.default_rng(seed).normal(size=(2, COUNT, 3)) * problem.squeeze.sum(-1)[:, None] / 5
    return problem._replace(wrench=np.concatenate([force, radius * torque + np.cross(middle, force)], -1))


def default_root(problem: P.Problems, weights: np.ndarray) -> np.ndarray:
    """Return R with |e| = |R e|: the torque about the weighted centroid, over the weighted rms radius."""
    centred_problem = R.centred(problem, weights)
    root = np.zeros((COUNT, 6, 6))
    for j, unit in enumerate(np.eye(6)):
        force, torque = np.broadcast_to(unit[:3], (COUNT, 3)), np.broadcast_to(unit[3:], (COUNT, 3))
        about = (torque - np.cross(np.asarray(centred_problem.centre, float), force)) / np.asarray(
            centred_problem.length, float
        )[:, None]
        root[:, :, j] = np.concatenate([force, about], -1)
    return root


def length(vectors: np.ndarray) -> np.ndarray:
    return np.linalg.norm(vectors, axis=-1)


def clarabel_distance(problem: P.Problems, weights: np.ndarray, root: np.ndarray, i: int) -> tuple[float, str]:
    """Solve min |R (w - G f)| over the cones, brought to order one, in the contacts' own axes."""
    clarabel, sparse = pytest.importorskip("clarabel"), pytest.importorskip("scipy.sparse")
    free = np.flatnonzero(weights[i] > 0)
    held = np.where(weights[i] > 0, 0, problem.squeeze[i])[:, None] * problem.normals[i]
    target = root[i] @ (problem.wrench[i] - P.exact_wrench(problem.points[i], held))
    columns = []
    for j in free:
        a, mu = problem.normals[i, j], problem.friction[i, j]
        first = P.unit(np.cross(a, np.eye(3)[np.argmin(np.abs(a))]))
        for axis in (a, mu * first, mu * np.cross(a, first)):
            columns.append(root[i] @ np.concatenate([axis, np.cross(problem.points[i, j], axis)]))
    matrix, size = np.array(columns).T, np.linalg.norm(target)
    unknowns = matrix.shape[1]
    rows = np.zeros((7 + unknowns, unknowns + 1))
    rows[0, -1], rows[1:7, :-1], rows[7:, :-1] = -1, matrix, -np.eye(unknowns)
    bound = np.concatenate([[0], target / size, np.zeros(unknowns)])
    kinds = [clarabel.SecondOrderConeT(7)] + [clarabel.SecondOrderConeT(3)] * len(free)
    settings = clarabel.DefaultSettings()
    settings.verbose, settings.max_iter = False, 200
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = 1e-13
    cost = np.append(np.zeros(unknowns), 1.0)
    nothing = sparse.csc_matrix((unknowns + 1, unknowns + 1))
    answer = clarabel.DefaultSolver(nothing, cost, sparse.csc_matrix(rows), bound, kinds, settings).solve()
    return answer.x[-1] * size, str(answer.status)


def agrees_with_clarabel(problem: P.Problems, weights: np.ndarray, root: np.ndarray, reachable):
    indices = np.flatnonzero(reachable.distance > 0)
    compared = 0
    for i in indices:
        expected, status = clarabel_distance(problem, weights, root, i)
        if "Solved" not in status:
            continue
        compared += 1
        assert abs(reachable.distance[i] - expected) <= DISTANCE * expected
    assert compared > 0.9 * len(indices)


def laws_hold(problem: P.Problems, weights: np.ndarray, root: np.ndarray, reachable):
    """Check that allowed forces exert the reached wrench, that the distance is right, and Moreau's theorem."""
    load = problem.squeeze.sum(-1) + length(np.einsum("bij,bj->bi", root, problem.wrench))
    forces = reachable.forces
    off = length(np.asarray(forces - R.project(forces, problem.normals, problem.friction), float)).max(-1)
    assert (off <= 1e-13 * load).all()
    exerted = np.einsum("bij,bj->bi", root, P.exact_wrench(problem.points, forces) - reachable.wrench)
    assert (length(exerted) <= 1e-9 * load).all()
    residual = np.einsum("bij,bj->bi", root, problem.wrench - reachable.wrench)
    np.testing.assert_allclose(length(residual), reachable.distance, atol=1e-12 * load.max())
    is_unreachable = reachable.distance > 0
    assert (reachable.verdict[is_unreachable] == Verdict.INFEASIBLE).all()
    held = np.where(weights > 0, 0, problem.squeeze)[..., None] * problem.normals
    free = np.einsum("bij,bj->bi", root, reachable.wrench - P.exact_wrench(problem.points, held))
    work = np.abs(np.sum(residual * free, -1))[is_unreachable]
    assert (work <= 1e-8 * (length(residual) * load)[is_unreachable]).all()
    need = R.proven_need(problem, weights, reachable.certificate)
    assert (need[is_unreachable] > 1e5).all()
    assert (reachable.certificate[~is_unreachable] == 0).all()


@pytest.mark.parametrize(
    "kind",
    [
        "infeasible",
        *(
            pytest.param(k, marks=pytest.mark.slow)
            for k in ("ordinary", "low_friction", "zero_friction", "far_frame", "scales")
        ),
    ],
)
def test_the_closest_wrench_is_reached_and_none_is_closer(kind):
    problem = asking(kind, seed=1)
    reachable = nearest(problem)
    assert (reachable.distance > 0).mean() > 0.2
    laws_hold(problem, problem.squeeze, default_root(problem, problem.squeeze), reachable)


@pytest.mark.parametrize("kind", ["infeasible", "ordinary", "low_friction"])
def test_distance_agrees_with_clarabel(kind):
    problem = asking(kind, seed=2)
    agrees_with_clarabel(problem, problem.squeeze, default_root(problem, problem.squeeze), nearest(problem))


def test_a_reachable_wrench_is_its_own_answer():
    problem = P.problems("ordinary", N, COUNT, seed=3)
    reachable = nearest(problem)
    assert (reachable.wrench == problem.wrench).all() and (reachable.distance == 0).all()
    assert np.isin(reachable.verdict, [Verdict.CLOSED_FORM_OPTIMAL, Verdict.OPTIMAL]).all()
    laws_hold(problem, problem.squeeze, default_root(problem, problem.squeeze), reachable)


@pytest.mark.slow
def test_reachable_wrenches_have_the_optimum_s_forces():
    problem = asking("ordinary", seed=3)
    grasp = Grasp(problem.points, problem.normals, problem.friction, problem.squeeze, EVERYONE)
    optimum = jax.device_get(jaxgrasp.constrained_optimum(grasp, problem.wrench, problem.squeeze))
    reachable, solved = nearest(problem), optimum.verdict <= Verdict.OPTIMAL
    assert 0.2 < solved.mean() < 0.8 and (solved == (reachable.distance == 0)).all()
    np.testing.assert_array_equal(reachable.forces[solved], optimum.forces[solved])
    assert (reachable.verdict[solved] == optimum.verdict[solved]).all()


def test_contacts_of_weight_zero_hold_their_squeezing_force():
    problem = asking("ordinary", seed=4)
    weights = np.ones((COUNT, N))
    weights[:, 0] = 0
    reachable = nearest(problem, weights)
    held = problem.squeeze[:, 0, None] * problem.normals[:, 0]
    np.testing.assert_allclose(reachable.forces[:, 0], held, rtol=1e-13, atol=1e-13)
    root = default_root(problem, weights)
    laws_hold(problem, weights, root, reachable)
    agrees_with_clarabel(problem, weights, root, reachable)


def body_inertia(problem: P.Problems, seed: int) -> np.ndarray:
    """Return spatial inertias of bodies near the contacts, about the frame's origin."""
    rng = np.random.default_rng(seed)
    mass = rng.uniform(0.1, 2.0, COUNT)
    radius = np.linalg.norm(problem.points - problem.points.mean(1, keepdims=True), axis=-1).mean(-1)
    centre = problem.points.mean(1) + radius[:, None] * rng.normal(size=(COUNT, 3)) / 3
    axes, _ = np.linalg.qr(rng.normal(size=(COUNT, 3, 3)))
    about_center = np.einsum("b,bij,bj,bkj->bik", mass * radius**2, axes, rng.uniform(0.3, 0.6, (COUNT, 3)), axes)
    cross = np.cross(np.eye(3), centre[:, None])  # rows: e_j x c, so this is the matrix of c x
    inertia = np.zeros((COUNT, 6, 6))
    inertia[:, :3, :3] = mass[:, None, None] * np.eye(3)
    inertia[:, 3:, :3] = mass[:, None, None] * cross
    inertia[:, :3, 3:] = np.swapaxes(inertia[:, 3:, :3], 1, 2)
    inertia[:, 3:, 3:] = about_center - mass[:, None, None] * cross @ cross
    return inertia


@pytest.mark.slow
def test_least_acceleration_agrees_with_clarabel():
    problem = asking("ordinary", seed=5)
    inertia = body_inertia(problem, seed=6)
    root = np.linalg.inv(np.linalg.cholesky(inertia))
    reachable = nearest(problem, inertia=inertia)
    assert (reachable.distance > 0).mean() > 0.2
    agrees_with_clarabel(problem, problem.squeeze, root, reachable)
    # The certificate is the acceleration that what is missed gives the body, up to a factor.
    is_unreachable = reachable.distance > 0
    acceleration = np.linalg.solve(inertia, (problem.wrench - reachable.wrench)[..., None])[is_unreachable, :, 0]
    # A far origin costs digits of the linear part: compare about the middle of the contacts.
    middle = problem.points.mean(1)[is_unreachable]
    about = [
        np.concatenate([t[:, :3] + np.cross(t[:, 3:], middle), t[:, 3:] * 0.05], -1)
        for t in (acceleration, reachable.certificate[is_unreachable])
    ]
    cosine = np.sum(about[0] * about[1], -1) / (length(about[0]) * length(about[1]))
    assert cosine.min() > 1 - 1e-9


def test_units_scale_and_frames_do_not_matter():
    problem = asking("ordinary", seed=7)
    reachable = nearest(problem)
    q, _ = np.linalg.qr(np.random.default_rng(8).normal(size=(3, 3)))
    q *= np.linalg.det(q)
    wrench = problem.wrench.reshape(COUNT, 2, 3) @ q.T
    turned = problem._replace(points=problem.points @ q.T, normals=problem.normals @ q.T, wrench=wrench.reshape(-1, 6))
    offset = np.array([0.5, -1.0, 2.0])
    torque = problem.wrench[:, 3:] + np.cross(offset, problem.wrench[:, :3])
    moved = problem._replace(points=problem.points + offset, wrench=np.concatenate([problem.wrench[:, :3], torque], -1))
    rescaled = problem._replace(
        points=problem.points * 1e3, squeeze=problem.squeeze * 1e-2, wrench=problem.wrench * np.repeat([1e-2, 10], 3)
    )
    for changed, factor in ((turned, 1.0), (moved, 1.0), (rescaled, 1e-2)):
        np.testing.assert_allclose(nearest(changed).distance, factor * reachable.distance, rtol=1e-8, atol=1e-14)


def of_pairs(wrench: np.ndarray) -> tuple[P.Problems, np.ndarray]:
    """Return two contacts 1 m apart on the x axis, friction 0.5, squeezed by 4 N; garbage in the third row."""
    points, normals = np.full((2, COUNT, N, 3), np.nan)
    points[:, :2], normals[:, :2] = [[0.5, 0, 0], [-0.5, 0, 0]], [[-1, 0, 0], [1, 0, 0]]
    friction, squeeze = np.full((COUNT, N), 0.5), np.full((COUNT, N), 4.0)
    wrench = np.broadcast_to(wrench, (COUNT, 6)).copy()
    present = np.repeat([[1.0, 1.0, 0.0]], COUNT, 0)
    return P.Problems("pair", points, normals, friction, squeeze, wrench, None), present


def test_known_answer_of_a_pair():
    """Torque about the line is missed, and all of it; the rest is held as the optimum would hold it."""
    problem, present = of_pairs(np.array([0, 0, 2.0, 0.3, 0, 0]))
    reachable = nearest(problem, problem.squeeze, present)
    np.testing.assert_allclose(reachable.wrench, np.broadcast_to([0, 0, 2.0, 0, 0, 0], (COUNT, 6)), atol=1e-9)
    # The contacts' radius is 0.5 m.
    np.testing.assert_allclose(reachable.distance, 0.6, rtol=1e-9)
    expected = np.broadcast_to([[-4, 0, 1], [4, 0, 1], [0, 0, 0]], (COUNT, N, 3))
    np.testing.assert_allclose(reachable.forces, expected, atol=1e-7)
    assert (reachable.forces[:, 2] == 0).all() and (reachable.verdict == Verdict.INFEASIBLE).all()


def test_known_answer_of_one_contact():
    """The projection on a single cone, at the contact itself."""
    problem, present = of_pairs(np.array([2.0, 0, 1.0, 0, 0.5, 0]))
    present[:, 0] = 0
    # One contact at x = -0.5 pushing along x: f = (2, 0, 1) is on its cone and gives the torque (0, 0.5, 0).
    reachable = nearest(problem, problem.squeeze, present)
    assert (reachable.distance == 0).all()
    problem = problem._replace(wrench=np.broadcast_to([0.0, 0, 1.0, 0, 0.5, 0], (COUNT, 6)).copy())
    reachable = nearest(problem, problem.squeeze, present)
    # Pure tangent (0, 0, 1): its projection on the edge (1, 0, 0.5) is (0.4, 0, 0.2).
    np.testing.assert_allclose(reachable.forces[:, 1], np.broadcast_to([0.4, 0, 0.2], (COUNT, 3)), atol=1e-9)
    np.testing.assert_allclose(reachable.distance, np.hypot(0.4, 0.8), rtol=1e-9)


def test_nobody_there_and_bad_data():
    problem, present = of_pairs(np.array([3.0, 0, 4.0, 0, 0, 0]))
    nobody = nearest(problem, problem.squeeze, 0 * present)
    assert (nobody.verdict == Verdict.NO_CONTACTS).all()
    assert np.abs(nobody.wrench).max() < 1e-14 and (nobody.forces == 0).all()
    np.testing.assert_allclose(nobody.distance, 5.0, rtol=1e-14)
    problem.points[::2, 0] = np.nan
    mixed = nearest(problem, problem.squeeze, present)
    assert (mixed.verdict[::2] == Verdict.INVALID_DATA).all() and np.isinf(mixed.distance[::2]).all()
    assert (mixed.verdict[1::2] == Verdict.OPTIMAL).all() and (mixed.distance[1::2] == 0).all()
    assert not any(np.isnan(leaf).any() for leaf in jax.tree.leaves(mixed))


def test_no_derivative_is_better_than_a_wrong_one():
    problem = asking("ordinary", seed=9)
    grasp = Grasp(problem.points, problem.normals, problem.friction, problem.squeeze)
    with pytest.raises(NotImplementedError, match="no derivatives"):
        jax.grad(lambda w: jaxgrasp.reachable_wrench(grasp, w).distance.sum())(problem.wrench)


def test_wrong_arguments_are_named(unchecked):
    problem = asking("ordinary", seed=9)
    with pytest.raises(ValueError, match="inertia has shape"):
        nearest(problem, inertia=np.eye(3))
    with pytest.raises(ValueError, match="sharing"):
        nearest(problem, "fair")


@pytest.mark.slow
@pytest.mark.optimized
def test_batches_names_and_transformations():
    problem = asking("ordinary", seed=10)
    grasp = Grasp(problem.points, problem.normals, problem.friction, problem.squeeze)
    reachable = nearest(problem)
    named = jaxgrasp.reachable_wrench(grasp, problem.wrench)
    mapped = jax.vmap(jaxgrasp.reachable_wrench)(grasp, problem.wrench)
    for other_reachable in (named, mapped):
        np.testing.assert_allclose(other_reachable.distance, reachable.distance, rtol=1e-9, atol=1e-14)
        assert (np.asarray(other_reachable.verdict) == reachable.verdict).all()
    single_grasp = jax.tree.map(lambda x: x[0], grasp)
    shared = jaxgrasp.reachable_wrench(single_grasp, problem.wrench.reshape(8, 8, 6))
    apart = jaxgrasp.reachable_wrench(jax.tree.map(lambda x: np.repeat(x[:1], COUNT, 0), grasp), problem.wrench)
    assert shared.distance.shape == (8, 8) and shared.forces.shape == (8, 8, N, 3)
    np.testing.assert_allclose(np.ravel(shared.distance), apart.distance, rtol=1e-9, atol=1e-14)


@pytest.mark.slow
@pytest.mark.repeats
@pytest.mark.parametrize("kind", ["infeasible", "ordinary", "low_friction", "coincident_some", "scales", "far_frame"])
def test_distance_agrees_with_clarabel_over_more_problems(kind):
    for seed in range(11, 17):
        problem = asking(kind, seed)
        for weights in (problem.squeeze, np.ones((COUNT, N))):
            reachable = nearest(problem, weights)
            agrees_with_clarabel(problem, weights, default_root(problem, weights), reachable)


@pytest.mark.slow
def test_out_of_reach_the_nearest_wrench_needs_no_optimum_first():
    """The same to the search's tolerance, which the distance feels by its square; in reach too."""
    problem = asking("ordinary", 3)
    grasp = Grasp(problem.points, problem.normals, problem.friction, problem.squeeze, EVERYONE)
    reachable, found = nearest(problem), jax.device_get(nearest_wrench(grasp, problem.wrench, problem.squeeze))
    is_out = reachable.verdict == Verdict.INFEASIBLE
    assert 5 < is_out.sum() < COUNT - 5
    np.testing.assert_array_equal(found.verdict[is_out], reachable.verdict[is_out])
    size = problem.squeeze.sum(-1)
    for name, tolerance in (("distance", DISTANCE), ("wrench", 1e-6), ("forces", 1e-5)):
        error = np.abs(getattr(found, name) - getattr(reachable, name)).reshape(COUNT, -1).max(-1) / size
        assert error[is_out].max() < tolerance, name
        assert name == "distance" or error[~is_out].max() < tolerance, name
