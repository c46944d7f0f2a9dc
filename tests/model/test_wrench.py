"""The grasp matrix against cross products and known singular values; the wrench that holds a weight."""

import numpy as np

from jaxgrasp import grasp_matrix, weight_wrench


def test_grasp_matrix_sums_forces_and_torques():
    rng = np.random.default_rng(0)
    points, forces = rng.normal(size=(2, 4, 7, 3)), rng.normal(size=(2, 4, 7, 3))
    total = np.einsum("...ij,...j->...i", grasp_matrix(points), forces.reshape(2, 4, 21))
    expected = np.concatenate([forces.sum(-2), np.cross(points, forces).sum(-2)], -1)
    np.testing.assert_allclose(total, expected, atol=1e-13)


def test_singular_values_of_a_triangle():
    angle = np.arange(3) * 2 * np.pi / 3
    points = np.stack([np.cos(angle), np.sin(angle), 0 * angle], -1)
    values = np.linalg.svd(grasp_matrix(points))[1]
    np.testing.assert_allclose(values, [3**0.5] * 4 + [1.5**0.5] * 2, rtol=1e-14)


def test_singular_values_of_six_contacts_on_the_axes():
    points = np.concatenate([np.eye(3), -np.eye(3)])
    np.testing.assert_allclose(np.linalg.svd(grasp_matrix(points))[1], [6**0.5] * 3 + [2.0] * 3, rtol=1e-14)


def test_single_precision_stays_single():
    assert grasp_matrix(np.ones((2, 3), np.float32)).dtype == np.float32


def test_holding_a_weight():
    """2 kg hanging at x = 0.1 m: lift with 19.62 N, and turn against its torque about y."""
    wrench = weight_wrench(2.0, np.array([0.1, 0, 0]), np.array([0, 0, -9.81]))
    np.testing.assert_allclose(wrench, [0, 0, 19.62, 0, -1.962, 0], atol=1e-14)


def test_weights_in_batches():
    rng = np.random.default_rng(1)
    mass, centre, gravity = rng.uniform(0, 3, 5), rng.normal(size=(5, 3)), rng.normal(size=3)
    wrenches = weight_wrench(mass, centre, np.broadcast_to(gravity, (5, 3)))
    for i in range(5):
        force = -mass[i] * gravity
        np.testing.assert_allclose(wrenches[i], np.concatenate([force, np.cross(centre[i], force)]), atol=1e-14)
