"""Sensitivity matrices: the derivatives by hand, the ways to take them alike, and names that mean what they say."""

import jax.numpy as jnp
import numpy as np
import pytest

import jaxgrasp
from jaxgrasp import Grasp, slip_angle
from jaxgrasp.grip import HeldCylinder, squeezing
from jaxgrasp.sensitivity import SensitivityMatrix, sensitivity_matrix

FINGERS = ("thumb", "index", "middle")
RNG = np.random.default_rng(3)
AZIMUTHS = np.array([3.0, 0.4, -0.6])
OUTWARD = np.stack([np.cos(AZIMUTHS), np.sin(AZIMUTHS), np.zeros(3)], -1)
VALUES = {
    "points": 0.05 * OUTWARD + 0.01 * RNG.normal(size=(3, 3)),
    "normals": -OUTWARD,
    "friction": np.array([0.5, 0.6, 0.7]),
    "contributions": np.array([2.0, 1.0, 0.8]),
    "stiffness": 900.0,
    "depths": np.array([2e-3, 3e-3, 2.5e-3]),
    "wrench": np.array([0.3, -0.2, 1.0, 0.01, 0.02, -0.005]),
}


def forces_by(method: str):
    solve = jaxgrasp.constrained_optimum if "optimum" in method else jaxgrasp.closed_form
    sharing = "uniform" if method[0] == "A" else "squeeze"

    def forces(p):
        squeeze = squeezing(p["contributions"], p["stiffness"], p["depths"])
        return solve(Grasp(p["points"], p["normals"], p["friction"], squeeze), p["wrench"], sharing).forces

    return forces


FORCES = {name: forces_by(name) for name in ("A", "B", "A-optimum", "B-optimum")}


def slips(p):
    grasp = Grasp(p["points"], p["normals"], p["friction"], squeezing(p["contributions"], p["stiffness"], p["depths"]))
    return {"slip_angle": slip_angle(grasp, FORCES["B"](p)), "forces": FORCES["B"](p)}


FEW = ["friction", "stiffness", "wrench", "contributions"]
"""By which several tests differentiate ``slips``: one program."""


def by_hand(method: str, name: str) -> np.ndarray:
    """Differentiate eqs. 11 and 15 by hand: f = s a + W G^T y, G f = w."""
    p, eye = VALUES, np.eye(3)
    squeeze = p["contributions"] * p["stiffness"] * p["depths"]
    cross = lambda r: np.array([[0, -r[2], r[1]], [r[2], 0, -r[0]], [-r[1], r[0], 0]])  # noqa: E731
    G = np.concatenate([np.concatenate([eye, cross(r)]) for r in p["points"]], 1)
    k = np.repeat(squeeze if method == "B" else np.ones(3), 3)
    inside = (squeeze[:, None] * p["normals"]).ravel()
    y = np.linalg.solve(G * k @ G.T, p["wrench"] - G @ inside)

    def moved(d_inside, dk, dG, dw):
        change = dw - dG @ (inside + k * (G.T @ y)) - G @ (d_inside + dk * (G.T @ y) + k * (dG.T @ y))
        return d_inside + dk * (G.T @ y) + k * (dG.T @ y) + k * (G.T @ np.linalg.solve(G * k @ G.T, change))

    columns = []
    for index in np.ndindex(np.shape(p[name])):
        unit = np.zeros(np.shape(p[name]))
        unit[index] = 1
        ds, da, dG, dw = np.zeros(3), np.zeros((3, 3)), np.zeros((6, 9)), np.zeros(6)
        if name in ("contributions", "stiffness", "depths"):
            others = {"contributions", "stiffness", "depths"} - {name}
            ds = unit * np.prod([np.broadcast_to(p[other_name], 3) for other_name in sorted(others)], axis=0)
        elif name == "normals":
            da = unit - np.sum(unit * p["normals"], 1, keepdims=True) * p["normals"]
        elif name == "points":
            dG = np.concatenate([np.concatenate([0 * eye, cross(r)]) for r in unit], 1)
        elif name == "wrench":
            dw = unit
        d_inside = (ds[:, None] * p["normals"] + squeeze[:, None] * da).ravel()
        columns.append(moved(d_inside, np.repeat(ds, 3) if method == "B" else 0 * k, dG, dw))
    return np.stack(columns, -1)


@pytest.fixture(
    scope="module", params=["A", "B", *(pytest.param(f"{m}-optimum", marks=pytest.mark.slow) for m in "AB")]
)
def method_and_matrix(request) -> tuple[str, SensitivityMatrix]:
    """Return a method, and its forces' derivatives by all parameters."""
    return request.param, sensitivity_matrix(FORCES[request.param], VALUES)


def test_closed_forms_by_hand(method_and_matrix):
    method, matrix = method_and_matrix
    np.testing.assert_allclose(matrix.nominal, FORCES[method](VALUES).ravel(), rtol=1e-12)
    assert matrix.derivatives.shape == (9, 3 * 3 + 3 * 3 + 3 + 3 + 1 + 3 + 6)
    for name in VALUES if "optimum" not in method else ():
        columns = [k for k, entry in enumerate(matrix.parameters) if entry.name == name]
        np.testing.assert_allclose(matrix.derivatives[:, columns], by_hand(method, name), rtol=1e-9, atol=1e-9)
        place = {0: "", 1: "[0]", 2: "[0, 0]"}[np.ndim(VALUES[name])]
        assert matrix.parameter_labels[columns[0]] == name + place


def test_forward_and_reverse_are_one(method_and_matrix):
    method, matrix = method_and_matrix
    forward = sensitivity_matrix(FORCES[method], VALUES, mode="forward")
    np.testing.assert_allclose(matrix.derivatives, forward.derivatives, rtol=1e-9, atol=1e-9)


@pytest.mark.slow
def test_any_tree_of_outputs_and_any_choice_of_parameters():
    labels = {"contributions": FINGERS, "slip_angle": FINGERS, "forces": FINGERS}
    matrix = sensitivity_matrix(slips, VALUES, ["contributions[index]", "stiffness", "points[0, 2]"], labels=labels)
    assert matrix.parameter_labels == ("contributions[index]", "stiffness", "points[0, 2]")
    assert matrix.output_labels[:1] + matrix.output_labels[-3:] == (
        "forces[thumb, 0]",
        *(f"slip_angle[{f}]" for f in FINGERS),
    )
    full_matrix = sensitivity_matrix(slips, VALUES)
    columns = [full_matrix.parameter_labels.index(name) for name in ("contributions[1]", "stiffness", "points[0, 2]")]
    np.testing.assert_allclose(matrix.derivatives, full_matrix.derivatives[:, columns], rtol=1e-9, atol=1e-12)
    assert [entry.unit for entry in matrix.parameters] == ["", "N/m", "m"]


def test_names_come_out_of_modules_too():
    cylinder = HeldCylinder(
        0.05, 0.2, AZIMUTHS, np.zeros(3), 0.6, np.ones(3), 900.0, np.full(3, 2e-3), 0.4, np.zeros(3)
    )

    def reach(task):
        return {"points": task["held"].grasp().points}

    matrix = sensitivity_matrix(reach, {"held": cylinder, "other": 1.0}, ["radius", "held.azimuths"])
    assert matrix.parameter_labels == ("radius", "azimuths[0]", "azimuths[1]", "azimuths[2]")
    np.testing.assert_allclose(matrix.derivatives[:, 0].reshape(3, 3), OUTWARD, atol=1e-12)
    everything = sensitivity_matrix(reach, {"held": cylinder, "other": 1.0}, ["held"])
    assert "other" not in everything.parameter_labels and "mass" in everything.parameter_labels


def test_elasticities_are_by_per_cent():
    """For a power law y = c x^p the elasticity is p everywhere."""
    matrix = sensitivity_matrix(lambda p: {"y": 3 * p["x"] ** 2.5 / p["z"]}, {"x": 1.7, "z": -0.4})
    np.testing.assert_allclose(matrix.relative(), [[2.5, -1]], rtol=1e-12)


def test_elasticities_at_zero():
    matrix = sensitivity_matrix(lambda p: jnp.stack([p["x"] - 1, p["y"], 0 * p["x"]]), {"x": 1.0, "y": 0.0})
    np.testing.assert_array_equal(matrix.relative(), [[np.inf, 0], [0, 0], [0, 0]])


def test_ranking_is_by_relative_influence():
    f = lambda p: {"a": jnp.stack([p["x"] + 0.1 * p["y"][0], p["x"] + 2 * p["y"][1]])}  # noqa: E731
    matrix = sensitivity_matrix(f, {"x": 1.0, "y": jnp.array([1.0, -0.5]), "idle": 4.0})
    ranked = matrix.ranking()
    assert [influence.label for influence in ranked] == ["x", "y[1]", "y[0]", "idle"]
    size = np.sqrt((1.1**2 + 0.0**2) / 2)
    np.testing.assert_allclose(
        [influence.size for influence in ranked], [1 / size, np.sqrt(0.5) / size, 0.1 * np.sqrt(0.5) / size, 0]
    )
    together = matrix.ranking({"y[0]": 50.0}, together=True)
    assert [influence.label for influence in together] == ["y", "x", "idle"]
    np.testing.assert_allclose(together[0].size, np.sqrt(25 / 2 + 0.5) / size)


def test_a_contact_without_force_moves_nothing():
    depths = np.array([2e-3, 0.0, 2.5e-3])
    pushed = squeezing(VALUES["contributions"], VALUES["stiffness"], depths)[:, None] * VALUES["normals"]
    wrench = np.asarray(jaxgrasp.grasp_matrix(VALUES["points"])) @ np.asarray(pushed).ravel()
    values = VALUES | {"depths": depths, "wrench": wrench}
    matrix = sensitivity_matrix(slips, values, FEW)
    assert np.isfinite(matrix.derivatives).all() and np.isneginf(matrix.nominal[-2])
    assert not np.any(matrix.derivatives[-2]) and not np.isnan(matrix.relative()).any()
    assert all(np.isfinite(influence.size) for influence in matrix.ranking())


@pytest.mark.slow
def test_what_has_no_derivative_is_left_out_of_the_ranking():
    """Contacts of limited force do not hold every wrench; forces that do not exist influence nothing."""
    several = jnp.stack([VALUES["wrench"], jnp.array([0, 0, 100.0, 0, 0, 0])])
    limits = jaxgrasp.Limits(normal_max=jnp.full(3, 10.0))

    def held(p):
        grasp = Grasp(p["points"], p["normals"], p["friction"], p["squeeze"])
        return {"forces": jaxgrasp.constrained_optimum(grasp, p["wrench"], limits=limits).forces}

    held_values = {name: VALUES[name] for name in ("points", "normals", "friction")} | {
        "squeeze": np.array([3.0, 4.0, 3.5])
    }
    matrix = sensitivity_matrix(held, held_values | {"wrench": several}, ["friction", "squeeze"])
    # Twice, so that one program serves both.
    alone = sensitivity_matrix(held, held_values | {"wrench": several[jnp.array([0, 0])]}, ["friction", "squeeze"])
    lost = np.isnan(matrix.derivatives).any(-1)
    assert lost.any() and not lost.all() and np.isfinite(alone.derivatives).all()
    assert [influence.label for influence in matrix.ranking()] == [influence.label for influence in alone.ranking()]
    np.testing.assert_allclose(
        *([influence.size for influence in ranked_matrix.ranking()] for ranked_matrix in (matrix, alone)), rtol=1e-12
    )


def test_columns_hold_every_pair():
    matrix = sensitivity_matrix(slips, VALUES, FEW)
    columns = matrix.columns()
    assert {len(column) for column in columns.values()} == {12 * 13}
    np.testing.assert_array_equal(columns["derivative"].reshape(12, 13), matrix.derivatives)
    assert columns["unit"][3] == "N per N/m" and columns["parameter"][3] == "stiffness"


@pytest.mark.parametrize(
    "by, message",
    [
        (["fricton"], "name 'fricton' is unknown: did you mean 'friction'?"),
        (["depths[3]"], r"name 'depths\[3\]' is unknown: did you mean 'depths\["),
        (["zzz"], "name 'zzz' is unknown: expected one or more of contributions, depths, friction"),
        ([], "no names of parameters are given: expected at least one"),
        ("friction", "expected a list, not one text"),
    ],
)
def test_unknown_names_are_said(by, message):
    with pytest.raises((TypeError, ValueError), match=message):
        sensitivity_matrix(FORCES["A"], VALUES, by)


def test_other_bad_input_is_said(unchecked):
    with pytest.raises(ValueError, match=r"friction\[1\] is nan: expected a finite number"):
        sensitivity_matrix(FORCES["A"], VALUES | {"friction": np.array([1, np.nan, 1])})
    with pytest.raises(ValueError, match="friction has 3 entries on its first axis: expected as many labels, not 2"):
        sensitivity_matrix(FORCES["A"], VALUES, labels={"friction": ("a", "b")})
    with pytest.raises(
        ValueError, match="labels are given for 'frictions', which is not a parameter or output: did you mean"
    ):
        sensitivity_matrix(FORCES["A"], VALUES, labels={"frictions": FINGERS})
    with pytest.raises(ValueError, match="no floating-point arrays"):
        sensitivity_matrix(lambda p: jnp.argmax(p["friction"]), VALUES)
    with pytest.raises(ValueError, match="two entries are called 'friction\\[a\\]'"):
        sensitivity_matrix(FORCES["A"], VALUES, labels={"friction": ("a", "b", "a")})
    with pytest.raises(ValueError, match="labels of friction are .*: expected strings"):
        sensitivity_matrix(FORCES["A"], VALUES, labels={"friction": (0, 1, 2)})
    matrix = sensitivity_matrix(lambda p: 2 * p["friction"], VALUES, ["friction"])
    with pytest.raises(ValueError, match="name 'stiffness' is unknown"):
        matrix.ranking({"stiffness": 1.0})
    with pytest.raises(ValueError, match="the spread of friction is nan: expected a finite number"):
        matrix.ranking({"friction": np.nan})


def test_another_mode_is_refused(unchecked):
    with pytest.raises(ValueError, match="mode is 'backward': expected 'forward' or 'reverse' or None"):
        sensitivity_matrix(FORCES["A"], VALUES, mode="backward")


def test_a_whole_path_means_what_is_there_alone():
    def doubled(p):
        return 2 * p["a"]["mass"] + 3 * p["b"]["a"]["mass"]

    values = {"a": {"mass": 1.0}, "b": {"a": {"mass": 2.0}}}
    assert len(sensitivity_matrix(doubled, values, ["a.mass"]).parameters) == 1
    matrix = sensitivity_matrix(doubled, values)
    np.testing.assert_allclose(
        sorted(influence.size for influence in matrix.ranking({"a.mass": 10.0})), [6 / 8, 20 / 8]
    )


def test_the_spread_of_an_entry_goes_before_its_arrays():
    matrix = sensitivity_matrix(lambda p: p["x"].sum(), {"x": jnp.array([1.0, 1.0])})
    for spreads in ({"x": 2.0, "x[0]": 0.0}, {"x[0]": 0.0, "x": 2.0}):
        assert {influence.label: influence.size for influence in matrix.ranking(spreads)} == {"x[0]": 0, "x[1]": 1}


def test_what_is_not_asked_for_may_be_no_number():
    values = VALUES | {"friction": np.array([1, np.nan, 1])}
    matrix = sensitivity_matrix(lambda p: p["points"] * p["stiffness"], values, ["stiffness"])
    assert np.isfinite(matrix.derivatives).all()


def test_plain_numbers_are_no_other_program():
    traces = []

    def f(p):
        traces.append(p)
        return p["x"] * 2

    for x in (1, 2.0, 3.5):
        assert sensitivity_matrix(f, {"x": x, "flag": True}).derivatives == 2
    # One trace tells the shapes of the outputs too.
    assert len(traces) == 1
