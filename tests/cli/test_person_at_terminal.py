"""A person at a pseudo-terminal of their own, asked without a glove: what the screen shows, and what the keys do."""

import os
import sys
import threading
from dataclasses import replace

import pytest

from jaxgrasp.cli.experiment_terminal import OtherTerminal, TerminalPerson
from jaxgrasp.psychophysics.plan import Plan, SessionPlan, StimulusPlan, StudyPlan
from jaxgrasp.psychophysics.procedures import ConstantStimuli
from jaxgrasp.psychophysics.records import read_records
from jaxgrasp.psychophysics.session import run_experiment
from jaxgrasp.psychophysics.trial import PredictedStimulus, Rendered
from tests.cli.pseudo_terminal import PersonAtTerminal

pytestmark = pytest.mark.skipif(os.name != "posix", reason="needs pseudo-terminals")
SEAT = [sys.executable, "-c", "import os, time; print(os.ttyname(0), flush=True); time.sleep(600)"]
SESSION = SessionPlan((0.05,), practice=1, least_interval=0.0, feedback=False)
PLAN = Plan(
    stimulus=StimulusPlan("torque"),
    session=SESSION,
    procedure=ConstantStimuli(levels=(0.2,), series=1),
    study=StudyPlan(consent="I take part of my own will.", questions=("age",)),
)


class StillAtFirst(PredictedStimulus):
    """The hand does not move the first time."""

    def __init__(self) -> None:
        super().__init__()
        self._moved = iter([0.0])

    def predict(self, intensity):
        return Rendered(
            intensity, intensity, intensity, False, full_intensity_s=1.0, motion_deg=next(self._moved, 20.0)
        )


def run_at_terminal(folder, plan: Plan, answers: dict[str, str]) -> tuple[str, list[dict]]:
    """Return the screen of a person who gives these answers, and the records of the session."""
    with PersonAtTerminal(SEAT) as seat:
        terminal = OtherTerminal(seat.reads("\n").strip())
        typing = threading.Thread(
            target=seat.plays,
            args=({prompt: lambda text=text: text for prompt, text in answers.items()},),
            kwargs={"stops": "over"},
        )
        typing.start()
        try:
            person = TerminalPerson(plan, terminal)
            run_experiment(plan, "S1", folder, StillAtFirst(), person, lost=lambda error: None)
        finally:
            terminal.show("over")
            typing.join()
            terminal.close()
        return seat.screen, read_records(folder / "S1.jsonl")[0]


ANSWERS = {
    "yes or no:": "yes",
    "age (Enter for no answer):": "34",
    "read this": "",
    "first one; Enter when you have": "",
    "second one; Enter when you have": "",
    "1 or 2?": "2",
    "ready": "",
}


def test_the_screen_from_consent_to_the_last_answer(folder):
    screen, records = run_at_terminal(folder, PLAN, ANSWERS)
    order = [
        "own will",
        "Do you agree",
        "age",
        "Bend your index MP joint to and fro; something resists it.",
        "trial 1 of 3",
    ]
    places = [screen.index(text) for text in order]
    assert places == sorted(places)
    assert "This trial does not count: the hand moved by 0.0 degrees: expected at least 5." in screen
    assert "Bend your index MP joint to and fro.\r\n" in screen, "the hint"
    assert "0.05" not in screen and "0.06" not in screen and "N\N{MIDDLE DOT}m" not in screen
    kinds = [record["record"] for record in records]
    assert kinds == ["begun", "consent", "about", "discarded", *["trial"] * 3]
    assert records[2]["answers"] == {"age": "34"} and [record["answer"] for record in records[4:]] == [2, 2, 2]


def test_stimuli_of_fixed_durations_begin_when_the_person_is_ready(folder):
    timed = replace(PLAN, session=replace(SESSION, duration=0.3, pause=0.2, least_whole=0.0), study=StudyPlan())
    screen, records = run_at_terminal(folder, timed, ANSWERS)
    assert "each for 0.3 s" in screen and screen.count("Enter when you are ready") == 4 and "  wait\r\n" in screen
    assert "Enter when you have " not in screen.replace("Enter when you have read this", "")
    assert all(0.3 <= lasted < 5 for record in records if record["record"] == "trial" for lasted in record["durations"])


def test_what_is_no_terminal_is_refused(folder):
    (folder / "file").write_text("")
    with pytest.raises(
        OSError, match="file is not a terminal: expected the path that `jaxgrasp experiment screen` prints"
    ):
        OtherTerminal(str(folder / "file"))
