"""Bounds that certificates prove, against the definition in extended precision and against forces that exist."""

import jax
import numpy as np
import pytest

import jaxgrasp
from jaxgrasp import Grasp, Verdict
from jaxgrasp.testing import problems as P
from jaxgrasp.testing import references as R

COUNT = 64
PROOF = 1e6
"""Total force, in units of the load, that a proof must show to be needed."""


def grasp_of(problem: P.Problems, present: np.ndarray | None = None) -> Grasp:
    return Grasp(problem.points, problem.normals, problem.friction, problem.squeeze, present)


def least(problem: P.Problems, direction: np.ndarray, sharing="squeeze", present: np.ndarray | None = None):
    return np.asarray(jaxgrasp.verify_certificate(grasp_of(problem, present), problem.wrench, direction, sharing))


def defined(problem: P.Problems, direction: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Compute the bound by its definition in extended precision: work left over the longest projected velocity."""
    centred_problem = R.centred(problem, weights)
    twist = centred_problem.scaled_twist(direction)
    velocity = centred_problem.velocities(twist)
    held = np.where(weights > 0, 0, centred_problem.squeeze * np.sum(velocity * centred_problem.normals, -1))
    work = np.sum(centred_problem.wrench * twist, -1) - held.sum(-1)
    reach = np.linalg.norm(
        np.asarray(R.project(velocity, centred_problem.normals, centred_problem.friction), float), axis=-1
    )
    largest = np.where(weights > 0, reach, 0).max(-1)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(work > 0, np.asarray(work, float) / largest, 0)


def random_directions(problem: P.Problems, seed: int) -> np.ndarray:
    """Return twists with linear and angular parts of one size about the middle of the contacts."""
    rng = np.random.default_rng(seed)
    linear, angular = rng.normal(size=(2, COUNT, 3))
    middle = problem.points.mean(1)
    angular /= np.linalg.norm(problem.points - middle[:, None], axis=-1).max(-1)[:, None]
    return np.concatenate([linear - np.cross(angular, middle), angular], -1)


@pytest.mark.parametrize("kind", ["ordinary", "some_zero_squeeze", "zero_friction", "far_frame", "scales"])
@pytest.mark.parametrize("sharing", ["squeeze", "uniform"])
def test_it_is_what_it_is_defined_as(kind, sharing):
    problem = P.problems(kind, 5, COUNT, seed=1)
    direction = random_directions(problem, seed=2)
    got, expected = least(problem, direction, sharing), defined(problem, direction, problem.weights(sharing))
    assert 0.2 < (expected > 0).mean() < 0.8
    # In a frame a hundred metres away the twist itself holds fewer digits.
    tolerance = 1e-9 if kind == "far_frame" else 1e-11
    np.testing.assert_allclose(got, expected, rtol=tolerance, atol=tolerance * problem.squeeze.sum(-1).min())


@pytest.mark.parametrize("kind", ["ordinary", "low_friction", "wide_squeeze", "far_frame"])
def test_no_forces_that_exist_are_proven_too_small(kind):
    """Weak duality: the optimum's forces give the wrench, so every direction asks for no more than they are."""
    problem = P.problems(kind, 5, COUNT, seed=3)
    forces = np.asarray(jaxgrasp.constrained_optimum(grasp_of(problem), problem.wrench).forces)
    total = np.linalg.norm(forces, axis=-1).sum(-1)
    for seed in range(8):
        assert (least(problem, random_directions(problem, seed)) <= total * (1 + 1e-9)).all()


def test_one_force_is_proven_exactly():
    """Along its own velocity a single force on its cone's surface works as hard as any of its size."""
    problem = P.problems("ordinary", 1, COUNT, seed=4)
    across = np.cross(problem.normals, np.random.default_rng(5).normal(size=(COUNT, 1, 3)))
    force = 3 * (problem.normals + problem.friction[..., None] * P.unit(across))
    problem = problem._replace(wrench=P.exact_wrench(problem.points, force))
    direction = np.concatenate([force[:, 0], np.zeros((COUNT, 3))], -1)
    np.testing.assert_allclose(least(problem, direction), np.linalg.norm(force[:, 0], axis=-1), rtol=1e-12)


@pytest.mark.slow
def test_squeezing_forces_that_exert_the_wrench_but_for_rounding_prove_nothing():
    problem = P.problems("ordinary", 5, COUNT, seed=7)
    wrench = P.exact_wrench(problem.points, problem.squeeze[..., None] * problem.normals)
    none = np.zeros((COUNT, 5))
    solution = jax.device_get(jaxgrasp.constrained_optimum(grasp_of(problem), wrench, none))
    assert (solution.verdict == Verdict.NO_CONTACTS).all() and not solution.certificate.any()
    pulled = jax.device_get(jaxgrasp.constrained_optimum(grasp_of(problem), 1.001 * wrench, none))
    proofs = jaxgrasp.verify_certificate(grasp_of(problem), 1.001 * wrench, pulled.certificate, none)
    assert (pulled.verdict == Verdict.NO_CONTACTS).all() and np.isinf(proofs).all()


@pytest.mark.parametrize("kind", ["infeasible", "zero_squeeze"])
def test_the_solver_s_certificates_prove(kind):
    problem = P.problems(kind, 5, COUNT, seed=6)
    solution = jax.device_get(jaxgrasp.constrained_optimum(grasp_of(problem), problem.wrench))
    assert np.isin(solution.verdict, [Verdict.INFEASIBLE, Verdict.NO_CONTACTS]).all()
    need = least(problem, solution.certificate)
    load = problem.squeeze.sum(-1) + np.linalg.norm(problem.wrench[:, :3], axis=-1)
    assert (need > PROOF * load).all()
    assert kind != "zero_squeeze" or np.isinf(need).all()
    # A total bounds the sum of normal forces from above, so it proves no less than that.
    normal = np.asarray(R.proven_need(problem, problem.squeeze, solution.certificate), float)
    assert (normal > PROOF).all()


def test_known_proofs_of_a_pair():
    """No torque about the line of two contacts; along the line they push as they like; backwards proves nothing."""
    points, normals = np.array([[0.5, 0, 0], [-0.5, 0, 0]]), np.array([[-1.0, 0, 0], [1, 0, 0]])
    grasp = Grasp(points, normals, np.full(2, 0.5), np.full(2, 4.0))
    about_line, lift = np.eye(6)[3], np.eye(6)[2]
    assert jaxgrasp.verify_certificate(grasp, 2 * about_line, about_line) == np.inf
    assert jaxgrasp.verify_certificate(grasp, 2 * about_line, -about_line) == 0
    assert jaxgrasp.verify_certificate(grasp, 2 * about_line, np.zeros(6)) == 0
    # To lift 3 N, forces on the surface of cones of half-angle atan 0.5 must be 3 / sin(atan 0.5) in all.
    np.testing.assert_allclose(jaxgrasp.verify_certificate(grasp, 3 * lift, lift), 3 * np.sqrt(5), rtol=1e-14)
    assert jaxgrasp.verify_certificate(grasp, 3 * lift, lift[None] * np.ones((4, 1))).shape == (4,)


def test_held_contacts_do_their_work_and_no_more():
    problem = P.problems("ordinary", 5, COUNT, seed=7)
    weights = np.ones((COUNT, 5))
    weights[:, :2] = 0
    direction = random_directions(problem, seed=8)
    expected = defined(problem, direction, weights)
    assert not np.allclose(expected, defined(problem, direction, np.ones((COUNT, 5))))
    np.testing.assert_allclose(least(problem, direction, weights), expected, rtol=1e-11, atol=1e-11)
    held = problem.squeeze[..., None] * problem.normals
    alone = problem._replace(wrench=P.exact_wrench(problem.points, held))
    # All is held: any other wrench is out of reach, and the held one is no proof of anything.
    assert least(alone, direction, 0 * weights).min() == 0
    work = np.sum(problem.wrench * direction, -1) > np.sum(alone.wrench * direction, -1)
    assert (np.isinf(least(problem, direction, 0 * weights)) == work).all()


def test_absent_contacts_and_bad_data():
    three = P.problems("ordinary", 3, COUNT, seed=9)
    direction = random_directions(three, seed=10)
    wide = {name: np.full((COUNT, 5, *getattr(three, name).shape[2:]), np.nan) for name in P.Contacts._fields}
    for name, array in wide.items():
        array[:, :3] = getattr(three, name)
    present = np.repeat([[1.0, 1.0, 1.0, 0.0, 0.0]], COUNT, 0)
    padded = three._replace(**wide)
    np.testing.assert_allclose(least(padded, direction, present=present), least(three, direction), rtol=1e-12)
    assert (least(padded, direction) == 0).all()
    assert (least(three, np.full_like(direction, np.nan)) == 0).all()


def test_batches_transformations_and_shapes():
    problem = P.problems("ordinary", 5, COUNT, seed=11)
    direction = random_directions(problem, seed=12)
    flat = least(problem, direction)
    single = jax.jit(jax.vmap(jaxgrasp.verify_certificate))(grasp_of(problem), problem.wrench, direction)
    np.testing.assert_allclose(single, flat, rtol=1e-12)
    # Its size does not matter, nor does that of the force or the unit of length.
    np.testing.assert_allclose(least(problem, 1e-3 * direction), flat, rtol=1e-12)
    with pytest.raises(ValueError, match="sharing"):
        least(problem, direction, "fair")


def test_wrong_shapes_are_named(unchecked):
    problem = P.problems("ordinary", 5, COUNT, seed=11)
    with pytest.raises(ValueError, match="expected"):
        least(problem, np.ones(5))
