"""``jaxgrasp teleop``: what it refuses before any work, and a trial from the command line."""

import csv

import pytest

from jaxgrasp.cli.main import main


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--delay", "-1"], "delay is -0.001"),
        (["--loss", "1"], "loss is 1.0: expected a share"),
        (["--trials", "0"], "trials is 0"),
        (["--robot", "127.0.0.1:5600"], "robot needs a glove: pass --glove PORT"),
        (["--seconds", "3"], "seconds needs a glove or a server"),
        (["--serve", "nowhere"], "serve is 'nowhere': expected HOST:PORT"),
        (["--glove", "no-such-port"], "no-such-port"),
        (["--serve", "127.0.0.1:5600", "--out", "trials.csv"], "out is for trials of the simulated person"),
        (["--wrist", "--no-feedback"], "wrist is a force on the simulated person's wrist: leave out --glove, --serve"),
        (["--wrist", "--serve", "127.0.0.1:5600"], "wrist is a force on the simulated person's wrist"),
    ],
)
def test_what_cannot_be_is_refused_before_any_work(folder, capsys, arguments, message):
    assert main(["teleop", *arguments]) == 1
    assert message in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [(["--trials", "2"], "trials is 2: expected 3 or more"), (["ball", "--trials", "5"], "scene is 'ball'")],
)
def test_ranks_over_trials_refuse_what_cannot_be(capsys, arguments, message):
    assert main(["glove", "ablate", *arguments]) == 1
    assert message in capsys.readouterr().err


@pytest.mark.slow
def test_trials_are_printed_and_written(folder, capsys, workplace):
    assert main(["teleop", "--scene", "stack", "--wrist", "--trials", "2", "--delay", "20", "--out", "trials.csv"]) == 0
    printed = capsys.readouterr().out
    assert "seed 0:" in printed and "seed 1:" in printed and "of 2 trials done" in printed
    with open("trials.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["seed"] for row in rows] == ["0", "1"]
    assert all(float(row["least_net_energy"]) >= -1e-3 for row in rows)


@pytest.mark.slow
def test_ranks_over_trials_are_printed(folder, capsys, workplace):
    assert main(["glove", "ablate", "--trials", "4", "--out", "ranks.csv"]) == 0
    assert "Kendall's tau" in capsys.readouterr().out
    with open("ranks.csv", newline="") as file:
        shares = [float(row["share"]) for row in csv.DictReader(file)]
    assert len(shares) == 14 and sum(shares) == pytest.approx(1, abs=1e-4) and shares == sorted(shares, reverse=True)
