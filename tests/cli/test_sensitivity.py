"""``jaxgrasp sensitivity``: what it writes is what the library says, and bad input is one line."""

import csv
import sys

import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrasp.cli.main import main
from jaxgrasp.sensitivity import (
    Output,
    SensitivityMatrix,
    cylinder_task,
    sensitivity_matrix,
    sensitivity_trajectory,
)
from jaxgrasp.sensitivity.study import at_worst, spells

QUICK = ["sensitivity", "--methods", "A", "--by", "mass", "friction[index]", "--step", "0.5", "--out", "out"]


@pytest.mark.slow
def test_it_writes_curves_ranking_and_figure(folder, capsys):
    assert main(QUICK) == 0
    output = capsys.readouterr().out
    assert "A: worst slip angle" in output and "pulled at from" in output and "reserve of friction" in output
    with open("out/sensitivity.csv") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 5 * 9
    expected = sensitivity_trajectory(cylinder_task(), np.linspace(0, 4, 9), Output("slip_angle", "A"), ["mass"])
    index = [row for row in rows if row["finger"] == "index"]
    np.testing.assert_allclose(
        [float(row["slip_angle [rad]"]) for row in index], expected.matrix.nominal[:, 1], rtol=1e-8
    )
    slopes = [float(row["d slip_angle / d mass [rad/(kg)]"]) for row in index]
    np.testing.assert_allclose(slopes, expected.matrix.derivatives[:, 1, 0], rtol=1e-8, atol=1e-8)
    with open("out/ranking.csv") as file:
        ranked = list(csv.DictReader(file))
    assert {row["of the worst"] for row in ranked} == {"slip angles, A", "reserve of friction"}
    assert ranked[0]["parameter"] == "mass" and float(ranked[1]["influence of 1% [%]"]) == 0
    with open("out/sensitivity.png", "rb") as file:
        assert len(file.read()) > 20_000


@pytest.mark.slow
def test_without_matplotlib_it_says_so(folder, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    assert main(QUICK) == 0
    assert "no figure: the figure needs matplotlib: pip install 'jaxgrasp[report]'" in capsys.readouterr().out


@pytest.mark.parametrize(
    "arguments, message",
    [
        (["--by", "fricton"], "name 'fricton' is unknown: did you mean 'friction'?"),
        (["--vary", "contributions[indx]"], "did you mean 'contributions[index]'?"),
        (["--step", "0"], "step is 0.0: expected a positive number"),
        (["--step", "5"], "step is 5.0: expected at most seconds, 4.0"),
    ],
)
def test_bad_input_is_one_line(folder, capsys, arguments, message):
    assert main(["sensitivity", "--methods", "A", *arguments]) == 1
    error = capsys.readouterr().err
    assert message in error and error.count("\n") == 1 and not any(folder.iterdir())


def test_a_shift_in_time_moves_no_worst():
    """For A sin(t - s) the maximum over time depends on A alone, though s moves every other instant as much."""
    times = np.linspace(0, 2 * np.pi, 2001)

    def curve(parameters):
        return {"y": parameters["amplitude"] * jnp.sin(times - parameters["shift"])}

    matrix = sensitivity_matrix(curve, {"amplitude": 2.0, "shift": 1.0})
    over_time = SensitivityMatrix(
        matrix.derivatives[:, None], matrix.nominal[:, None], matrix.values, matrix.outputs[:1], matrix.parameters
    )
    sizes = {influence.label: influence.size for influence in over_time.ranking()}
    assert sizes["shift"] > 0.9
    for largest in (True, False):
        worst = at_worst(over_time, largest=largest)
        np.testing.assert_allclose(worst.nominal, [2.0 if largest else -2.0], rtol=1e-5)
        sizes = {influence.label: influence.size for influence in worst.ranking()}
        np.testing.assert_allclose(sizes["amplitude"], 1, rtol=1e-5)
        assert sizes["shift"] < 2e-3


def test_spells_begin_and_end_between_instants():
    times, is_present = np.array([0.0, 1, 2, 3, 4]), np.array([True, False, True, True, False])
    assert spells(times, is_present) == [(0.0, 0.5), (1.5, 3.5)]
    assert spells(times, ~is_present) == [(0.5, 1.5), (3.5, 4.0)]
    assert spells(times, is_present & False) == []
