"""``jaxgrasp experiment``: planned, run by an observer and by a person at a terminal, analysed."""

import contextlib
import csv
import io
import itertools
import json
import os
import subprocess
import sys
import threading
import time

import pytest

from jaxgrasp.cli.main import main
from jaxgrasp.psychophysics.analysis.experiment import load_experiment
from jaxgrasp.psychophysics.person import SimulatedPerson
from tests.cli.pseudo_terminal import PersonAtTerminal

PLAN = """
[session]
references = [1.0, 2.0]
practice = 1
[procedure]
series = 2
"""
TORQUE = """
name = "one joint"
[stimulus]
kind = "torque"
[session]
references = [0.05]
practice = 1
break_every = 5
least_interval = 0.0
least_movement = 0.0
least_whole = 0.0
[procedure]
levels = [0.2, 0.4]
series = 1
"""


def _slowly(text: str) -> str:
    """Return the text after the time that a person takes to feel first."""
    time.sleep(1.5)
    return text


PERSON = {
    "have read this": lambda: "",
    "first one; Enter when you have": lambda: _slowly(""),
    "second one; Enter when you have": lambda: _slowly(""),
    "1 or 2?": lambda: "1",
    "Enter to go on": lambda: "",
}


@pytest.fixture
def plan(folder):
    (folder / "plan.toml").write_text(PLAN)
    return "plan.toml"


def test_paper(capsys):
    assert main(["experiment", "paper"]) == 0
    output = capsys.readouterr().out
    assert "14.85 (14.26 to 15.46)     impossible" in output and "0.133 (0.130 to 0.137)" in output
    assert output.splitlines()[-1].startswith("7 reproduced; 2 impossible; 6 reproduced, by another estimator")


@pytest.mark.slow
def test_plan(folder, capsys):
    assert main(["experiment", "plan", "--write", "paper.toml"]) == 0
    output = capsys.readouterr().out
    assert "trials of a person: 124, 4 of them practice" in output
    assert "WARNING" not in output
    assert (
        "In the paper's Fig. 8 it lies on the distal phalanges of index and middle" in output
        and "bears 2.71 N" in output
    )
    assert main(["experiment", "plan", "paper.toml", "--write", "paper.toml"]) == 1
    assert "expected a file that does not exist yet" in capsys.readouterr().err
    assert main(["experiment", "plan", "paper.toml"]) == 0
    capsys.readouterr()
    (folder / "two.toml").write_text('[stimulus]\nfingers = ["index", "middle"]')
    assert main(["experiment", "plan", "two.toml"]) == 0
    output = capsys.readouterr().out
    assert (
        "WARNING: 5 of 15 stimuli need more torque than the glove has, from 3 N on" in output and "Fig. 8" not in output
    )


def test_an_observer_is_run_and_analysed(folder, plan, capsys):
    for subject in ("S1", "S2", "S3"):
        options = ["--subject", subject, "--simulate", "--weber", "0.1", "--absolute", "0.05"]
        assert main(["experiment", "run", plan, *options]) == 0
    assert "33 trials are in" in capsys.readouterr().out
    assert main(["experiment", "analyse", "jaxgrasp-experiment"]) == 0
    output = capsys.readouterr().out
    assert "all at 1 N: " in output and "JND of all: limit " in output and " persons at 1 N: mean" in output
    analysis = json.loads((folder / "jaxgrasp-experiment" / "analysis.json").read_text())
    assert [cell["counts"]["trials"] for cell in analysis["pooled"]] == [[12] * 4] * 2
    assert (folder / "jaxgrasp-experiment" / "report.html").stat().st_size > 10**6
    assert main(["experiment", "analyse", "jaxgrasp-experiment", "--method", "paper", "--no-report"]) == 0
    for options, message in (
        (["run", plan, "--subject", "S1", "--simulate"], "add --resume to continue it"),
        (["run", plan, "--subject", "S1", "--port", "x", "--resume"], "was begun by a simulated observer"),
        (["run", plan, "--subject", "all", "--simulate"], "stands for all persons together"),
        (["analyse", "jaxgrasp-experiment", "--criterion", "0.3"], "criterion is 0.3"),
    ):
        assert main(["experiment", *options]) == 1
        assert message in capsys.readouterr().err
    assert main(["experiment", "analyse", "jaxgrasp-experiment", "--method", "line", "--criterion", "0.96"]) == 0


@pytest.mark.slow
def test_power(folder, capsys):
    (folder / "fig8.toml").write_text('[stimulus]\nfingers = ["index", "middle"]\n')
    assert main(["experiment", "power", "fig8.toml", "--wanted", "0.03"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert "WARNING: 5 of 15 stimuli need more torque" in lines[1]
    totals = [int(line.split()[2]) for line in lines[3:]]
    assert totals == sorted(totals) and len(totals) >= 3
    assert main(["experiment", "power", "--wanted", "0.0001"]) == 0
    assert "no design" in capsys.readouterr().out


def test_detection_needs_to_be_told(folder, capsys):
    """Power analysis of detection needs --wanted and --between, and an observer with an absolute threshold."""
    (folder / "plan.toml").write_text("[session]\nreferences = [0]\n[procedure]\nlevels = [0.1, 0.2, 0.4]")
    for arguments, message in (
        (["power", "plan.toml", "--absolute", "0.15"], "detection needs --wanted and --between [N]"),
        (["power", "plan.toml"], "absolute is 0.0: expected the observer's threshold [N]"),
        (["run", "plan.toml", "--subject", "S1", "--simulate"], "absolute is 0.0"),
        (["run", "plan.toml", "--subject", "S1", "--port", "nowhere"], "port nowhere cannot be opened"),
    ):
        assert main(["experiment", *arguments]) == 1
        assert message in capsys.readouterr().err
    options = ["--absolute", "0.15", "--wanted", "0.02", "--between", "0.03"]
    assert main(["experiment", "power", "plan.toml", *options]) == 0


@pytest.mark.parametrize(
    "arguments, message",
    [
        (["run", "--subject", "S1"], "expected either --port"),
        (["run", "--subject", "Jane Doe", "--simulate"], "expected a code of letters"),
        (["run", "no.toml", "--subject", "S1", "--simulate"], "no.toml"),
        (["run", "--subject", "S1", "--simulate", "--weber", "-1"], "weber is -1.0"),
        (["analyse", "."], "has no records"),
        (["analyse", ".", "--lapse", "0.7"], "lapse is 0.7"),
        (["power", "--wanted", "0"], "wanted is 0"),
        (["power", "--reference", "7"], "reference is 7: expected one of 1, 2, 3"),
    ],
)
def test_bad_arguments(folder, capsys, arguments, message):
    assert main(["experiment", *arguments]) == 1
    assert message in capsys.readouterr().err
    assert not list(folder.iterdir())


def test_a_person_stops_and_goes_on(folder, monkeypatch, capsys):
    """Answers by the keyboard; the end of the input is where one stops."""
    from jaxgrasp.cli import experiment_run
    from jaxgrasp.psychophysics.trial import IdealStimulus

    (folder / "plan.toml").write_text(TORQUE)
    monkeypatch.setattr(experiment_run, "_armed_glove", lambda *_: (IdealStimulus(), lambda: None))
    command = ["experiment", "run", "plan.toml", "--subject", "S1", "--port", "nowhere", "--resume"]
    # What is no answer is asked again; the input ends in the middle of the third trial.
    monkeypatch.setattr(sys, "stdin", io.StringIO("\n\n\n1\n\n\n3\nx\n2\n\n"))
    assert main(command) == 1
    out, err = capsys.readouterr()
    assert "all answers are in" in err and "which one was stronger, 1 or 2?" in out
    assert [trial["answer"] for trial in load_experiment(folder / "jaxgrasp-experiment").trials["S1"]] == [1, 2]
    monkeypatch.setattr(sys, "stdin", io.StringIO("\n" + "\n\n1\n" * 2 + "\n" + "\n\n1\n" * 4))
    assert main(command) == 0
    assert "5 trials are in" in capsys.readouterr().out


def test_a_person_matches(folder, monkeypatch, capsys):
    from jaxgrasp.cli import experiment_run
    from jaxgrasp.psychophysics.trial import IdealStimulus

    settings = '[procedure]\nmethod = "matching"\ntrials = 2\nstep = 0.1'
    (folder / "plan.toml").write_text("[session]\nreferences = [2.0]\npractice = 0\nleast_interval = 0.0\n" + settings)
    monkeypatch.setattr(experiment_run, "_armed_glove", lambda *_: (IdealStimulus(), lambda: None))
    monkeypatch.setattr(sys, "stdin", io.StringIO("\n\n+\nr\nc\n?\n+\n-\n\n" + "\n\n"))
    assert main(["experiment", "run", "plan.toml", "--subject", "S1", "--port", "nowhere"]) == 0
    first, second = load_experiment(folder / "jaxgrasp-experiment").trials["S1"]
    assert first["setting"] == pytest.approx(first["second"] + 0.2) and second["setting"] == second["second"]
    assert main(["experiment", "analyse", "jaxgrasp-experiment"]) == 0
    assert "2 settings, error" in capsys.readouterr().out


POSIX = pytest.mark.skipif(os.name != "posix", reason="needs pseudo-terminals")
PROGRAM = [sys.executable, "-m", "jaxgrasp.cli.main"]


@POSIX
@pytest.mark.slow
@pytest.mark.realtime
def test_a_person_at_a_screen_of_their_own_sees_neither_stimuli_nor_torques(folder):
    """The experimenter's terminal arms and shows each trial; the person's has instructions, questions and the hint."""
    (folder / "plan.toml").write_text(TORQUE.replace("least_movement = 0.0", "least_movement = 5.0"))
    simulated = [*PROGRAM, "glove", "simulate", "--bend", "30", "--port"]
    run = [*PROGRAM, "experiment", "run", "plan.toml", "--subject", "S1", "--port", "glove"]
    with contextlib.ExitStack() as opened:
        glove = opened.enter_context(subprocess.Popen([*simulated, "glove"], stdout=subprocess.PIPE))
        opened.callback(glove.kill)
        glove.stdout.readline()
        seat = opened.enter_context(PersonAtTerminal([*PROGRAM, "experiment", "screen"]))
        seat.reads("--screen ")
        device = seat.reads("\n").strip()
        desk = opened.enter_context(PersonAtTerminal([*run, "--screen", device]))
        orders = {"of the glove's torque:": lambda: "arm", "for all of it:": lambda: "arm"}
        desk.reads("nothing is armed")
        desk.reads("torque: ")
        desk.type("x")
        typing = threading.Thread(target=seat.plays, args=(PERSON,), kwargs={"stops": "that was all"})
        typing.start()
        code = desk.plays(orders)
        assert code == 0, desk.screen
        typing.join()
    assert "Bend your index MP joint to and fro" in seat.screen and "torque" not in seat.screen
    assert "0.05" not in seat.screen and "0.06" in desk.screen and "N\N{MIDDLE DOT}m" in desk.screen
    assert "which one" not in desk.screen and "trial 5: " in desk.screen
    for trial in load_experiment(folder / "jaxgrasp-experiment").trials["S1"]:
        assert min(trial["moved"]) >= 5 and min(trial["durations"]) > 0.5


@pytest.mark.slow
@pytest.mark.realtime
@POSIX
def test_in_a_glove(folder):
    """A whole experiment through a simulated glove: armed at a twentieth, then at all, and each answer typed."""
    (folder / "plan.toml").write_text(TORQUE)
    simulated = [*PROGRAM, "glove", "simulate", "--seconds", "300"]
    with subprocess.Popen(simulated, stdout=subprocess.PIPE) as glove:
        glove.stdout.readline()
        run = [*PROGRAM, "experiment", "run", "plan.toml", "--subject", "S1", "--port", "jaxgrasp-glove"]
        with subprocess.Popen(run, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
            # Not before it asks: what is typed ahead would be answered without having been felt.
            assert any("nothing is armed" in line for line in process.stdout)
            # Armed in so many words; then Enter feels and rests, and is asked again where a number is wanted.
            lines = itertools.chain(["", "1", "arm", "arm", ""], itertools.cycle(["", "1", "", "2"]))
            end = time.perf_counter() + 120
            with contextlib.suppress(BrokenPipeError):
                while process.poll() is None and time.perf_counter() < end:
                    process.stdin.write(next(lines) + "\n")
                    process.stdin.flush()
                    time.sleep(0.7)
                process.stdin.close()
            process.wait(60)
        glove.terminate()
    trials = load_experiment(folder / "jaxgrasp-experiment").trials["S1"]
    assert len(trials) == 5 and not any(trial["saturated"] for trial in trials)
    for trial in trials:
        assert max(trial["torque"]) == pytest.approx(max(trial["first"], trial["second"]))


TABLES = ("trials", "thresholds", "persons", "dictionary")
CHAIN = """
name = "ten"
[session]
references = [1.0, 2.0]
order = "balanced"
practice = 2
[procedure]
method = "%s"
%s
[study]
title = "Ten observers"
questions = ["age"]
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    "method, settings",
    [("constant-stimuli", "series = 1"), ("adaptive", "trials = 30")],
)
def test_ten_observers_through_all_commands(folder, monkeypatch, capsys, method, settings):
    """Planned, run, one of them interrupted and gone on with, analysed, exported: every answer is in the tables."""
    (folder / "plan.toml").write_text(CHAIN % (method, settings))
    assert main(["experiment", "plan", "plan.toml"]) == 0
    assert "min or so" in capsys.readouterr().out
    choose, numbers = SimulatedPerson.choose, []

    def interrupted(person, trial, rendered):
        numbers.append(trial.number)
        if len(numbers) == 8:
            raise KeyboardInterrupt
        return choose(person, trial, rendered)

    for k in range(1, 11):
        run = [
            "experiment",
            "run",
            "plan.toml",
            "--subject",
            f"S{k:02d}",
            "--simulate",
            "--weber",
            f"{0.08 + 0.01 * k}",
        ]
        if k == 4:
            with monkeypatch.context() as patched:
                patched.setattr(SimulatedPerson, "choose", interrupted)
                assert main(run) == 1
            assert "--resume goes on with them" in capsys.readouterr().err
            assert main(run) == 1 and "already exists" in capsys.readouterr().err
            run.append("--resume")
        assert main(run) == 0
    capsys.readouterr()
    assert main(["experiment", "analyse", "jaxgrasp-experiment", "--no-report"]) == 0
    output = capsys.readouterr().out
    assert "10 person(s)" in output
    assert main(["experiment", "export", "jaxgrasp-experiment"]) == 0
    out = folder / "jaxgrasp-experiment" / "export"
    tables = {name: list(csv.DictReader((out / f"{name}.csv").read_text().splitlines())) for name in TABLES}
    records = load_experiment(folder / "jaxgrasp-experiment").trials
    assert [row["trial"] for row in tables["trials"] if row["subject"] == "S04"] == [
        str(record["number"]) for record in records["S04"]
    ]
    for row, record in zip(
        tables["trials"], (record for who in sorted(records) for record in records[who]), strict=True
    ):
        assert float(row["first [N]"]) == record["first"] and row["right"] == str(int(record["right"]))
        assert row["practice"] == str(int(record["is_practice"]))
    assert [row["resumed"] for row in tables["persons"]] == ["1" if k == 4 else "0" for k in range(1, 11)]
    analysis = json.loads((folder / "jaxgrasp-experiment" / "analysis.json").read_text())
    assert [row["threshold"] for row in tables["thresholds"] if row["subject"] == "S07"] == [
        ""
        if cell["threshold"]["estimate"] is None or cell["threshold"]["finding"] != "found"
        else repr(cell["threshold"]["estimate"])
        for cell in analysis["cells"]
        if cell["subject"] == "S07"
    ]
    described = {(row["file"], row["column"]) for row in tables["dictionary"]}
    assert described == {(f"{name}.csv", head) for name in TABLES[:3] for head in tables[name][0]}
    first = [next(record["reference"] for record in records[who]) for who in sorted(records)]
    assert sorted(first) == [1.0] * 5 + [2.0] * 5, "balanced over persons"
