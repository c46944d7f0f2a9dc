"""Grasps that must squeeze harder than they mean to are told apart from those that hold."""

from dataclasses import replace

import numpy as np
import pytest

import jaxgrasp
from jaxgrasp.batch.contact_sets import ContactSets
from jaxgrasp.batch.reasons import Reason
from jaxgrasp.cli.main import main


def pinches(friction, squeeze, lift, **labels):
    """Return pinches that lift; each contact needs lift / (2 friction) of normal force."""
    count = len(lift)
    return ContactSets(
        np.tile([[0.03, 0, 0], [-0.03, 0, 0]], (count, 1)),
        np.tile([[-1.0, 0, 0], [1.0, 0, 0]], (count, 1)),
        np.repeat(friction, 2),
        np.repeat(squeeze, 2),
        2 * np.arange(count + 1),
        np.column_stack([np.zeros((count, 2)), lift, np.zeros((count, 3))])[:, None],
        labels={name: np.array(values) for name, values in labels.items()},
    )


FRICTION, SQUEEZE = np.array([0.2, 0.5, 1.0, 0.05, 0.3, 0.3]), np.array([3.0, 5.0, 0.5, 1.0, 1.0, 0.0])
LIFT = np.array([2.44, 2.0, 4.0, 1.0, 0.3, 0.3])


@pytest.mark.parametrize(
    "methods", [pytest.param(("A", "B", "A-optimum", "B-optimum"), marks=pytest.mark.slow), ("A-optimum",)]
)
def test_a_pinch_needs_the_normal_force_of_coulombs_law(methods):
    evaluation = jaxgrasp.evaluate(pinches(FRICTION, SQUEEZE, LIFT), methods=methods)
    needed = LIFT / (2 * FRICTION)
    with np.errstate(divide="ignore"):
        expected = np.where(SQUEEZE > 0, np.maximum(needed / SQUEEZE, 1), np.nan)
    np.testing.assert_allclose(evaluation.squeeze_factor[:, 0], expected, rtol=1e-6)
    table = evaluation.table()
    assert table["holds"].tolist() == ["harder", "yes", "harder", "harder", "yes", "yes"]
    assert table["why"][0] == "holds if it squeezes harder"
    np.testing.assert_array_equal(table["squeeze_factor"], evaluation.squeeze_factor[:, 0])
    assert (evaluation.summary.ranked.holds, evaluation.summary.ranked.harder) == (3, 3)


def test_random_grasps_hold_once_they_squeeze_by_the_factor_and_need_little_more_than_the_least():
    rng = np.random.default_rng(0)
    points = rng.normal(size=(100, 4, 3))
    points /= np.linalg.norm(points, axis=-1, keepdims=True)
    column_of_ones = np.ones((100, 4))
    grasp = jaxgrasp.Grasp(0.03 * points, -points, 0.5 * column_of_ones, rng.uniform(0.3, 3.0, (100, 4)))
    sets = ContactSets.from_grasp(grasp, np.array([0, 0, 4.0, 0, 0, 0]))
    methods = ("A", "A-optimum")
    evaluation = jaxgrasp.evaluate(sets, methods=methods)
    factor, why = evaluation.squeeze_factor[:, 0], evaluation.why[:, 0]
    held = np.isin(why, (Reason.HOLDS, Reason.HARDER))
    assert (why == Reason.HARDER).sum() > 20 and (why == Reason.HOLDS).sum() > 10
    np.testing.assert_array_equal(np.isfinite(factor), held)
    harder = np.repeat(np.where(held, factor * 1.001, 1), 4)
    again = jaxgrasp.evaluate(replace(sets, squeeze=sets.squeeze * harder), methods=methods)
    # The factor is that of forces which hold, not of the least ones: less than a twentieth is left.
    assert (again.why[held, 0] == Reason.HOLDS).mean() > 0.9 and again.squeeze_factor[held, 0].max() < 1.05
    # No forces press less than the least inside the pyramids around the cones.
    for k in np.flatnonzero(why == Reason.HARDER)[:10].tolist():
        least = least_total_of_pyramid(sets.grasp(k), sets.wrench[k, 0])
        assert (
            least / sets.grasp(k).squeeze.sum() <= factor[k] * (1 + 1e-6)
            and factor[k] < 1.5 * least / sets.grasp(k).squeeze.sum()
        )


def least_total_of_pyramid(grasp, wrench, sides=64):
    """Return the least sum of normal forces inside the pyramids around the cones, which exert the wrench, by a linear
    program."""
    from scipy.optimize import linprog

    columns = []
    for point, normal, friction in zip(grasp.points, grasp.normals, grasp.friction, strict=True):
        first = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
        first /= np.linalg.norm(first)
        second = np.cross(normal, first)
        for turn in 2 * np.pi * np.arange(sides) / sides:
            edge = normal + friction / np.cos(np.pi / sides) * (np.cos(turn) * first + np.sin(turn) * second)
            columns.append(np.concatenate([edge, np.cross(point, edge)]))
    return linprog(np.ones(len(columns)), A_eq=np.array(columns).T, b_eq=wrench).fun


def test_the_console_and_the_table_say_so(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    jaxgrasp.save_grasps("pinches.npz", pinches(FRICTION[:2], SQUEEZE[:2], LIFT[:2], name=["mug", "box"]))
    assert main(["evaluate", "pinches.npz", "--no-report"]) == 0
    output = capsys.readouterr().out
    assert "1 of 2 grasps hold" in output and "1 more if the hand squeezes harder (mug: 2.1 times)" in output
    assert "holds if it squeezes harder" in (tmp_path / "jaxgrasp-results" / "results.csv").read_text()
