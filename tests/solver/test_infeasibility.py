"""Proofs that forces do not exist, from directions that are not quite one yet."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrasp import Grasp, Verdict, constrained_optimum
from jaxgrasp.numerics.vec3 import Vec3
from jaxgrasp.problem import spatial
from jaxgrasp.problem.batch_last import ProblemBatch
from jaxgrasp.problem.scaled_problem import in_principal_axes
from jaxgrasp.problem.scaling import certificate_from_scaled, twist_to_scaled
from jaxgrasp.solver.infeasibility import find_certificate, proven_force_bound

COUNT = 600


def lifts(n: int, seed: int) -> tuple[np.ndarray, ...]:
    """Return random contacts on the upper half of a ball, which is lifted."""
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(COUNT, n, 3))
    points /= np.linalg.norm(points, axis=-1, keepdims=True)
    points[..., 2] = np.abs(points[..., 2])
    friction, squeeze = rng.uniform(0.2, 0.6, (COUNT, n)), rng.uniform(0.5, 5, (COUNT, n))
    return points, friction, squeeze, np.tile([0, 0, 3.0, 0, 0, 0], (COUNT, 1))


@pytest.mark.slow
@pytest.mark.repeats
@pytest.mark.parametrize("n", [3, 5, 10])
def test_a_direction_that_nearly_proves_is_often_turned_into_a_proof(n):
    points, friction, squeeze, wrench = lifts(n, n)
    arrays = [jnp.asarray(x) for x in (points, -points, friction, squeeze)]
    solution = constrained_optimum(Grasp(*arrays), jnp.asarray(wrench))
    infeasible = np.asarray(solution.verdict) == Verdict.INFEASIBLE
    assert infeasible.sum() > COUNT / 10
    proof = np.asarray(solution.certificate)[infeasible]
    points, friction, squeeze, wrench = (x[infeasible] for x in (points, friction, squeeze, wrench))
    noise = np.random.default_rng(0).normal(size=proof.shape)
    nearly = proof + 3e-3 * np.linalg.norm(proof, axis=-1, keepdims=True) * noise
    open_ = need(points, friction, wrench, nearly) < 1e6
    assert open_.sum() > COUNT / 20

    fields = (points, -points, friction, squeeze, None, np.ones_like(friction), wrench)
    problem = in_principal_axes(ProblemBatch(*(None if x is None else jnp.asarray(x) for x in fields)))
    twist = twist_to_scaled(Vec3(*nearly.T[:3, None]), Vec3(*nearly.T[3:, None]), problem.scaling)
    direction = problem.coordinates.from_twist(*twist)
    certificate = find_certificate(problem, direction, 0 * direction)
    proven = np.asarray(certificate.force_bound)[0] > 0
    # Of those that miss by a little; without turning none is.
    assert proven[open_].mean() > 0.4
    turned = spatial.join(*certificate_from_scaled(*spatial.parts(certificate.direction), problem.scaling))
    assert need(points, friction, wrench, np.asarray(turned).T)[proven].min() > 1e6


def need(points, friction, wrench, direction):
    """Compute the total normal force that a twist proves to be needed; the contacts' normals point to the centre."""
    velocity = direction[:, None, :3] + np.cross(direction[:, None, 3:], points)
    along = -np.einsum("bni,bni->bn", velocity, points)
    across = np.linalg.norm(velocity + along[..., None] * points, axis=-1)
    work = np.einsum("bi,bi->b", direction, wrench)
    return work / np.maximum(np.max(along + friction * across, -1), 1e-12 * np.abs(work))


def test_absent_contacts_weaken_no_proof():
    """Their points lie anywhere, here ten metres off, and their levers multiply no rounding."""
    points, _, squeeze, wrench = lifts(4, 1)
    points = 0.05 * points + 10
    wrench = np.concatenate([wrench[:, :3], np.cross([10.0, 10, 10], wrench[:, :3])], -1)
    none = jnp.zeros((1, COUNT))

    def bound(contacts: slice, present: np.ndarray | None) -> np.ndarray:
        arrays = (points[:, contacts], 10 - points[:, contacts], 0 * squeeze[:, contacts], squeeze[:, contacts])
        fields = (*arrays, present, squeeze[:, contacts], wrench)
        problem = in_principal_axes(ProblemBatch(*(None if x is None else jnp.asarray(x) for x in fields)))
        upward = twist_to_scaled(Vec3(none, none, none + 1), Vec3(none, none, none), problem.scaling)
        direction = problem.coordinates.from_twist(*upward)
        return np.asarray(proven_force_bound(problem, direction))

    expected = bound(slice(3), None)
    assert np.all(expected > 1e6)
    np.testing.assert_allclose(bound(slice(4), np.tile([1.0, 1, 1, 0], (COUNT, 1))), expected, rtol=1e-6)
