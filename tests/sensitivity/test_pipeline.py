"""Sensitivity through the whole pipeline: from a hand's joints to contacts, forces, slip angles and joint torques."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxgrasp
from jaxgrasp.grip import Body, Scene, observe, power_grip
from jaxgrasp.hand import Cylinder, Pose, Posture, human_hand
from jaxgrasp.sensitivity import sensitivity_matrix
from jaxgrasp.sensitivity.naming import with_values

HAND = human_hand()
DOWN = jnp.array([0.0, 0.0, -1.0])
SIXTH_ORDER = {1: 3 / 4, 2: -3 / 20, 3: 1 / 60}
BY = ("angles", "radius", "friction", "stiffness", "mass", "origin")


def held(parameters):
    """Hold a cylinder: slip angles by B and by its optimum, the optimum's torques, and the least squeeze."""
    body = Body(Cylinder(parameters["radius"], 0.12), parameters["mass"])
    far_below = Pose(jnp.array([0.0, 0.0, -9.0]), jnp.eye(3))
    units = jnp.ones(len(HAND.links))
    scene = Scene(HAND, body, far_below, parameters["friction"], parameters["stiffness"], units, 9.81 * DOWN)
    tick = observe(scene, parameters["posture"], parameters["placed"], law="optimum")
    grasp = tick.grasp
    return {
        "slip": jaxgrasp.slip_angle(grasp, tick.assessment.closed.forces),
        "optimum_slip": jaxgrasp.slip_angle(grasp, tick.assessment.optimum.forces),
        "torques": tick.torques,
        "least": jaxgrasp.least_squeeze(grasp, tick.wrench),
    }


@pytest.fixture(scope="module")
def parameters():
    posture, placed, contacts = power_grip(HAND, Cylinder(0.03, 0.12))
    # A little deeper, so that no sphere is about to leave.
    posture = Posture(posture.wrist, jnp.asarray(posture.angles) * 1.01)
    assert float(contacts.present.sum()) >= 6
    return {
        "posture": posture,
        "placed": placed,
        "radius": 0.03,
        "friction": 0.4,
        "stiffness": 800.0,
        "mass": 0.8,
    }


@pytest.mark.slow
def test_derivatives_are_limits_of_differences(parameters):
    matrix = sensitivity_matrix(held, parameters, BY)
    assert {"angles", "radius", "mass"} <= {parameter.name for parameter in matrix.parameters}
    values = np.asarray(matrix.values)
    row = jax.jit(lambda x: jnp.concatenate([a.ravel() for a in jax.tree.leaves(held(put(x)))]))
    put = lambda x: with_values(jax.tree.map(jnp.asarray, parameters), matrix.parameters, x)  # noqa: E731
    nominal = np.asarray(row(values))
    loaded = np.isfinite(nominal)
    assert loaded.sum() > 20
    errors = []
    for h in (1e-4, 2e-5, 4e-6):
        columns = []
        for k in range(len(values)):
            step = np.zeros(len(values))
            step[k] = h * max(abs(values[k]), 0.05)
            sides = [c * (row(values + m * step) - row(values - m * step)) for m, c in SIXTH_ORDER.items()]
            columns.append(np.asarray(sum(sides)) / step[k])
        errors.append(np.abs(np.stack(columns, -1) - matrix.derivatives)[loaded])
    scale = 1 + np.abs(np.asarray(matrix.derivatives))[loaded].max(1, keepdims=True)
    error = np.nanmin(errors, 0) / scale
    assert error.max() < 1e-5
    assert np.quantile(error, 0.9) < 1e-8


@pytest.mark.slow
def test_what_the_pipeline_must_say(parameters):
    """Friction leaves B alone and spares squeeze, mass asks for more; weight and squeeze together scale torques."""
    matrix = sensitivity_matrix(held, parameters, ["friction", "stiffness", "mass", "angles"])
    columns = {label: np.asarray(matrix.derivatives)[:, k] for k, label in enumerate(matrix.parameter_labels)}
    names = np.array([output.name for output in matrix.outputs])
    assert np.all(columns["friction"][names == "slip"] == 0)
    assert columns["friction"][names == "least"] < 0
    assert columns["mass"][names == "least"] > 0
    # Squeeze and weight scaled alike scale forces and torques: Euler's theorem on homogeneous functions.
    torques = np.asarray(matrix.nominal)[names == "torques"]
    by_both = 800.0 * columns["stiffness"] + 0.8 * columns["mass"]
    np.testing.assert_allclose(by_both[names == "torques"], torques, atol=1e-7 * np.abs(torques).max())
    np.testing.assert_allclose(by_both[names == "slip"], 0, atol=1e-7)
