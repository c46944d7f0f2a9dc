"""Sensitivity trajectories: the paper's task, exact derivatives along it, varied curves, bad input."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxgrasp
from jaxgrasp.grip import Task
from jaxgrasp.sensitivity import Output, cylinder_task, friction_reserve, sensitivity_trajectory
from jaxgrasp.sensitivity.naming import with_values
from jaxgrasp.sensitivity.task_file import FINGERS, INDEX_CONTRIBUTIONS
from jaxgrasp.sensitivity.trajectory import trajectory_call

TIMES = np.linspace(0.013, 3.987, 31)
"""None of them an instant at which a finger comes to its cone, where a derivative has two sides."""
BY = ["contributions", "friction", "depths", "radius", "mass", "speed"]
LABELS = dict.fromkeys(("contributions", "friction", "depths", "slip_angle"), FINGERS)
OUTPUTS = {method: Output("slip_angle", method) for method in ("A", "B", "A-optimum", "B-optimum")}
STEPS = (1e-3, 2e-4, 2e-5)
SIXTH_ORDER = {1: 3 / 4, 2: -3 / 20, 3: 1 / 60}
INDEX = FINGERS.index("index")


def slips(task: Task, method: str, times=TIMES) -> np.ndarray:
    """Return the slip angles ``(T, 5)`` [degrees]."""
    return np.degrees(sensitivity_trajectory(task, times, OUTPUTS[method], ["mass"]).matrix.nominal)


def unstable(times: np.ndarray, bad: np.ndarray) -> list[float]:
    """Return the times at which a spell begins or ends."""
    return [float(times[k]) for k in np.flatnonzero(np.diff(bad.astype(int)))]


@pytest.mark.slow
def test_the_paper_s_task_loses_the_index_by_method_a_when_it_says_so():
    times = np.linspace(0, 4, 801)
    slip = {method: slips(cylinder_task(), method, times) for method in ("A", "B", "B-optimum")}
    np.testing.assert_allclose(unstable(times, slip["A"][:, INDEX] > 90), [0.5, 1.5, 2.5, 3.5], atol=0.1)
    assert slip["A"].max() > 90 > slip["B"].max() > slip["B-optimum"].max()
    assert slip["B-optimum"].max() <= np.degrees(np.arctan(0.5)) + 1e-9


@pytest.mark.slow
def test_b_is_not_better_at_every_instant():
    """The paper says that its margin is always greater: the worst one is, but not every one."""
    times = np.linspace(0, 4, 801)
    a, b = (slips(cylinder_task(), method, times)[:, INDEX] for method in "AB")
    assert b.max() < a.max() and (b > a).any()


@pytest.mark.parametrize(
    "method", ["B", *(pytest.param(m, marks=pytest.mark.slow) for m in ("A", "A-optimum", "B-optimum"))]
)
def test_derivatives_are_limits_of_differences(method):
    task = cylinder_task()
    trajectory = sensitivity_trajectory(task, TIMES, OUTPUTS[method], BY)
    entries = trajectory.matrix.parameters
    assert len(entries) == 18 and trajectory.matrix.derivatives.shape == (len(TIMES), 5, 18)

    @jax.jit
    def curves(values):
        grasp, wrench = jax.vmap(Task(with_values(task.parameters, entries, values), task.at))(TIMES)
        return OUTPUTS[method](grasp, wrench)["slip_angle"]

    nominal = np.asarray(curves(trajectory.matrix.values))
    np.testing.assert_allclose(trajectory.matrix.nominal, nominal, atol=1e-12)
    # Long steps meet kinks. Over short ones counts that an optimum whose search ends a step sooner is 1e-12 off.
    errors = [np.abs(differences(curves, trajectory.matrix.values, h) - trajectory.matrix.derivatives) for h in STEPS]
    error = np.min(errors, 0) / (1 + np.abs(trajectory.matrix.derivatives))
    assert error[np.isfinite(nominal)].max() < 1e-8
    # A finger that carries nothing has no angle.
    assert not np.any(np.asarray(trajectory.matrix.derivatives)[~np.isfinite(nominal)])


def differences(curves, values, h: float) -> np.ndarray:
    """Compute central differences of sixth order, by a share of each parameter."""
    columns = []
    for k, value in enumerate(values):
        step = np.zeros(len(values))
        step[k] = h * value
        sides = [c * (curves(values + m * step) - curves(values - m * step)) for m, c in SIXTH_ORDER.items()]
        columns.append(np.asarray(sum(sides)) / step[k])
    return np.stack(columns, -1)


@pytest.mark.slow
def test_at_the_cones_surface_the_angle_is_the_cones():
    """There it moves with the friction alone, by 1 / (1 + mu^2); elsewhere not with its own friction alone."""
    trajectory = sensitivity_trajectory(cylinder_task(), TIMES, OUTPUTS["B-optimum"], ["friction"], labels=LABELS)
    on_cone = np.abs(np.asarray(trajectory.matrix.nominal) - np.arctan(0.5)) < 1e-9
    assert 0.1 < on_cone.mean() < 0.9
    derivatives = np.asarray(trajectory.matrix.derivatives)[on_cone]
    expected = np.broadcast_to(np.eye(5) / 1.25, (*on_cone.shape, 5))[on_cone]
    np.testing.assert_allclose(derivatives, expected, atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("method", ["B", "B-optimum"])
def test_both_directions_are_one(method):
    few, many = ["contributions", "mass"], ["held"]
    by_few = sensitivity_trajectory(cylinder_task(), TIMES, _first_slip(method), few)
    by_one = sensitivity_trajectory(cylinder_task(), TIMES, OUTPUTS[method], ["mass"])
    by_many = sensitivity_trajectory(cylinder_task(), TIMES, OUTPUTS[method], many)
    assert len(by_few.matrix.parameters) > len(by_few.matrix.outputs) and len(by_many.matrix.parameters) > 20
    mass = by_many.matrix.parameter_labels.index("mass")
    np.testing.assert_allclose(by_one.matrix.derivatives[..., 0], by_many.matrix.derivatives[..., mass], atol=1e-9)
    np.testing.assert_allclose(by_few.matrix.derivatives[:, 0, -1], by_one.matrix.derivatives[:, 0, 0], atol=1e-9)


def _first_slip(method: str):
    def slip(grasp, wrench):
        return {"slip": OUTPUTS[method](grasp, wrench)["slip_angle"][..., :1]}

    return slip


@pytest.mark.slow
@pytest.mark.repeats
@pytest.mark.parametrize("method, digits", [("A", 1e-10), ("B", 1e-10), ("B-optimum", 1e-10), ("reserve", 1e-5)])
def test_code_that_is_compiled_quickly_says_the_same(method, digits):
    """Quickly compiled code gives the same values; at a limit the reserve's derivatives are only known to 1e-6."""
    output, vary = (friction_reserve, {}) if method == "reserve" else (OUTPUTS[method], {"radius": (0.04,)})
    arguments = (cylinder_task(), TIMES, output, BY)
    trajectory, quickly = (trajectory_call(*arguments, vary=vary, once=once)() for once in (False, True))
    # A parameter that moves nothing, as the radius of all, moves it by rounding of what the others do.
    least = digits * np.abs(trajectory.matrix.derivatives * trajectory.matrix.values).max()
    for leaf, quick in zip(jax.tree.leaves(trajectory.varied), jax.tree.leaves(quickly.varied), strict=True):
        np.testing.assert_allclose(leaf, quick, rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(trajectory.matrix.nominal, quickly.matrix.nominal, rtol=1e-10)
    relative, quick = (curve.matrix.derivatives * curve.matrix.values for curve in (trajectory, quickly))
    np.testing.assert_allclose(relative, quick, rtol=digits, atol=least)


@pytest.mark.slow
def test_varied_curves_and_their_prediction():
    contribution = float(cylinder_task().parameters.held.contributions[INDEX])
    values = (*INDEX_CONTRIBUTIONS, contribution, 1.01 * contribution, 1.005 * contribution)
    name = "contributions[index]"
    trajectory = sensitivity_trajectory(
        cylinder_task(), TIMES, OUTPUTS["B"], ["mass"], vary={name: values, "friction": (0.3,)}, labels=LABELS
    )
    varied = trajectory.varied[name]
    assert trajectory.matrix.parameter_labels == ("mass",) and varied.curves.shape == (6, len(TIMES), 5)
    for value, curve in zip(values, varied.curves, strict=True):
        held = cylinder_task().parameters.held
        contributions = held.contributions.at[INDEX].set(value)
        task = jaxgrasp.grip.carrying(
            _with(held, contributions), cylinder_task().parameters.path, cylinder_task().parameters.gravity
        )
        np.testing.assert_allclose(np.degrees(curve), slips(task, "B"), atol=1e-9)
    np.testing.assert_allclose(varied.error[3], 0, atol=1e-14)
    # To first order right: half the change, a quarter of the error.
    np.testing.assert_allclose(np.abs(varied.error[4]).max() / np.abs(varied.error[5]).max(), 4, rtol=0.1)
    np.testing.assert_allclose(trajectory.varied["friction"].curves[0], trajectory.matrix.nominal, atol=1e-12)


def _with(held, contributions):
    values = {name: getattr(held, name) for name in held.__dataclass_fields__}
    return type(held)(**(values | {"contributions": contributions}))


@pytest.mark.slow
def test_any_function_of_grasp_and_wrench_is_an_output():
    trajectory = sensitivity_trajectory(cylinder_task(), TIMES[:5], jaxgrasp.least_squeeze, ["friction", "mass"])
    assert trajectory.matrix.output_labels == ("least_squeeze",) and trajectory.matrix.outputs[0].unit == "N"
    # Twice the mass, twice the force.
    np.testing.assert_allclose(trajectory.matrix.relative()[:, 0, -1], 1, rtol=1e-6)


def test_bad_input_is_said():
    task, out = cylinder_task(), OUTPUTS["A"]
    with pytest.raises(ValueError, match=r"times\[2\] is 0.1: expected more than times\[1\], 0.2"):
        sensitivity_trajectory(task, [0.0, 0.2, 0.1], out)
    with pytest.raises(ValueError, match=r"times\[1\] is nan: expected a finite number of seconds"):
        sensitivity_trajectory(task, [0.0, np.nan], out)
    with pytest.raises(ValueError, match=r"times has shape \(0,\): expected one axis with at least one entry"):
        sensitivity_trajectory(task, [], out)
    with pytest.raises(ValueError, match="name 'contribution' is unknown: did you mean 'contributions'?"):
        sensitivity_trajectory(task, TIMES, out, ["contribution"])
    with pytest.raises(ValueError, match="name 'radios' is unknown: did you mean 'radius'?"):
        sensitivity_trajectory(task, TIMES, out, vary={"radios": (1.0,)})
    with pytest.raises(ValueError, match=r"values of radius\[1\] is inf: expected a finite number"):
        sensitivity_trajectory(task, TIMES, out, vary={"radius": (1.0, np.inf)})
    with pytest.raises(ValueError, match="quantity 'slip' is unknown: expected one of forces, slip_angle"):
        Output("slip", "A")
    with pytest.raises(ValueError, match="method 'C' is unknown"):
        Output("slip_angle", "C")


def test_tasks_that_return_something_else_are_said():
    grasp, wrench = cylinder_task()(0.0)

    def try_out(function, output=OUTPUTS["A"]):
        sensitivity_trajectory(Task({"x": 1.0}, function), TIMES, output)

    with pytest.raises(ValueError, match=r"the task returns \(Grasp\): expected a Grasp and a wrench"):
        try_out(lambda p, t: (grasp,))
    with pytest.raises(ValueError, match=r"the task returns \(Grasp\): expected a Grasp and a wrench"):
        try_out(lambda p, t: grasp)
    with pytest.raises(ValueError, match=r"the task's wrench has shape \(3,\): expected \(6,\)"):
        try_out(lambda p, t: (grasp, wrench[:3]))
    two = jax.tree.map(lambda x: jnp.stack([x, x]), grasp)
    with pytest.raises(ValueError, match=r"the task's grasp's points has shape \(2, 5, 3\): expected \(5, 3\)"):
        try_out(lambda p, t: (two, wrench))
    with pytest.raises(ValueError, match=r"the output has shape \(\): expected the axis of the 31 times first"):
        try_out(lambda p, t: (grasp, wrench), lambda grasp, wrench: jnp.sum(wrench))
    with pytest.raises(ValueError, match=r"x is nan: expected a finite number"):
        sensitivity_trajectory(Task({"x": np.nan}, lambda p, t: (grasp, wrench)), TIMES, OUTPUTS["A"])


def test_a_trajectory_prints_in_some_ten_lines():
    """The paper's task with all of its parameters prints the ranges of its curves and the largest influences."""
    trajectory = sensitivity_trajectory(cylinder_task(), TIMES, OUTPUTS["B"], BY, vary={"mass": (0.2, 0.4)})
    np.testing.assert_array_equal(trajectory.curves, trajectory.matrix.nominal)
    lines = str(trajectory).splitlines()
    assert len(lines) <= 12 and max(map(len, lines)) < 200
    curve = np.asarray(trajectory.curves[:, 0])
    assert lines[1] == f"  slip_angle[0]: {curve.min():.4g} to {curve.max():.4g} rad"
    assert trajectory.matrix.ranking()[0].label in lines[-2] and lines[-1] == "  varied: mass = 0.2, 0.4"
    assert "SensitivityTrajectory(" in jax.eval_shape(lambda traced: traced, trajectory).__str__()
