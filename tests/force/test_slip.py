"""Slip angles and margins: their meaning at both ends, for unloaded and absent contacts, and their derivatives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrasp import Grasp, friction_margin, slip_angle, stability_margin


def one_contact(force, normal=(0.0, 0.0, 1.0), friction=0.5, present=None) -> tuple[Grasp, np.ndarray]:
    present = None if present is None else np.array([present])
    grasp = Grasp(np.zeros((1, 3)), np.array([normal]), np.array([friction]), np.ones(1), present)
    return grasp, np.array([force], float)


@pytest.mark.parametrize("degrees", [0, 1e-6, 30, 45, 90, 135, 180 - 1e-6, 180])
def test_angle_between_force_and_normal(degrees):
    angle = np.deg2rad(degrees)
    grasp, force = one_contact([3 * np.sin(angle), 0, 3 * np.cos(angle)])
    # Both ends keep their digits: 1e-6 degrees is far below the square root of machine precision.
    np.testing.assert_allclose(slip_angle(grasp, force), angle, rtol=1e-8, atol=1e-15)
    np.testing.assert_allclose(stability_margin(grasp, force), np.pi / 2 - angle, rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(friction_margin(grasp, force), np.arctan(0.5) - angle, rtol=1e-12, atol=1e-15)


def test_margin_vanishes_on_the_cone():
    grasp, force = one_contact([0.5, 0, 1])
    assert abs(float(friction_margin(grasp, force)[0])) < 1e-15


def test_angle_does_not_see_the_size_of_the_force():
    for size in (1e-12, 1.0, 1e12):
        grasp, force = one_contact([0.3 * size, 0.4 * size, size])
        np.testing.assert_allclose(slip_angle(grasp, force), np.arctan(0.5), rtol=1e-14)


@pytest.mark.parametrize("present", [None, 1.0, 0.0])
def test_a_contact_without_force_has_no_angle(present):
    grasp, force = one_contact([0, 0, 0], present=present)
    assert slip_angle(grasp, force)[0] == -np.inf
    assert stability_margin(grasp, force)[0] == np.inf
    assert friction_margin(grasp, force)[0] == np.inf


def test_an_absent_contact_has_no_angle_whatever_it_holds():
    grasp, force = one_contact([1, 0, 1], present=0.0)
    assert slip_angle(grasp, force)[0] == -np.inf
    assert friction_margin(grasp, force)[0] == np.inf


def test_worst_contact_is_a_loaded_one():
    normals = np.tile([0.0, 0.0, 1.0], (3, 1))
    forces = np.array([[0.0, 0, 1], [0, 0, 0], [0.2, 0, 1]])
    grasp = Grasp(np.zeros((3, 3)), normals, np.full(3, 0.5), np.ones(3))
    np.testing.assert_allclose(jnp.max(slip_angle(grasp, forces)), np.arctan(0.2), rtol=1e-14)
    np.testing.assert_allclose(jnp.min(friction_margin(grasp, forces)), np.arctan(0.5) - np.arctan(0.2), rtol=1e-14)


def test_derivative_matches_the_formula():
    grasp, force = one_contact([0.3, 0, 1.0])
    gradient = jax.grad(lambda f: slip_angle(grasp, f).sum())(force)
    # d atan2(t, p) = (p dt - t dp) / (t^2 + p^2)
    np.testing.assert_allclose(gradient, [[1.0 / 1.09, 0, -0.3 / 1.09]], rtol=1e-12)


@pytest.mark.parametrize("force", [[0, 0, 0], [0, 0, 2], [0, 0, -2]])
def test_derivatives_are_finite_where_the_angle_has_a_kink(force):
    grasp, force = one_contact(force)
    for measure in (slip_angle, stability_margin, friction_margin):
        for derivative in (jax.jacfwd, jax.jacrev):
            assert np.isfinite(derivative(lambda f, measure=measure: measure(grasp, f))(force)).all()
    assert (np.asarray(jax.grad(lambda f: slip_angle(grasp, f).sum())(force)) == 0).all()


def test_unloaded_contacts_send_no_nan_to_normals_or_friction():
    grasp, force = one_contact([0, 0, 0])
    for measure in (slip_angle, friction_margin):
        gradient = jax.grad(lambda g, measure=measure: measure(g, force).sum())(grasp)
        assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(gradient))
