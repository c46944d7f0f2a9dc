"""A person at a pseudo-terminal of their own, asked without a glove: what the screen shows, and what the keys do."""

import contextlib
import os
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import replace

import pytest

from jaxgrasp.cli.experiment_terminal import OtherTerminal, TerminalPerson
from jaxgrasp.psychophysics.plan import Plan, SessionPlan, StimulusPlan, StudyPlan
from jaxgrasp.psychophysics.procedures import ConstantStimuli
from jaxgrasp.psychophysics.records import read_records
from jaxgrasp.psychophysics.session import run_experiment
from jaxgrasp.psychophysics.trial import PredictedStimulus, Rendered, StimulusLostError
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


class Dies(PredictedStimulus):
    """Glove that lets go while the first stimulus is felt, once it is told to."""

    def __init__(self) -> None:
        super().__init__()
        self.is_dead = threading.Event()

    def predict(self, intensity):
        return Rendered(intensity, intensity, intensity, False, full_intensity_s=9.0, motion_deg=20.0)

    def is_lost(self):
        return self.is_dead.is_set()

    def end(self):
        if self.is_dead.is_set():
            raise StimulusLostError("the glove released during the stimulus: its cable was cut", super().end())
        return super().end()


@contextlib.contextmanager
def seated(folder, plan: Plan, stimulus: PredictedStimulus) -> Iterator[tuple[PersonAtTerminal, list[BaseException]]]:
    """Run an experiment in a thread until its end; yield the person's terminal and the error that ended it."""
    errors: list[BaseException] = []
    with PersonAtTerminal(SEAT) as seat:
        terminal = OtherTerminal(seat.reads("\n").strip())

        def leave(error: StimulusLostError) -> None:
            raise error

        def run() -> None:
            try:
                run_experiment(plan, "S1", folder, stimulus, TerminalPerson(plan, terminal), lost=leave)
            except BaseException as error:
                errors.append(error)

        running = threading.Thread(target=run)
        running.start()
        try:
            yield seat, errors
        finally:
            # Whatever failed, the end of its terminal ends the run.
            terminal.close()
            running.join(10)
        assert not running.is_alive()


NO_STUDY = replace(PLAN, study=StudyPlan())
TIMED = replace(NO_STUDY, session=replace(SESSION, duration=30.0, least_whole=0.0))


@pytest.mark.parametrize("plan", [NO_STUDY, TIMED])
def test_the_screen_changes_at_once_when_the_glove_lets_go(folder, plan):
    """The person who feels the first stimulus types nothing meanwhile."""
    stimulus = Dies()
    with seated(folder, plan, stimulus) as (seat, errors):
        seat.reads("read this ")
        seat.type("")
        if plan is TIMED:
            seat.reads("ready ")
            seat.type("")
        seat.reads("feel the first one")
        time.sleep(0.2)
        stimulus.is_dead.set()
        died = time.perf_counter()
        seat.reads("This trial does not count: the glove let go")
        assert time.perf_counter() - died < 0.3
        while not errors:
            time.sleep(0.01)
    assert isinstance(errors[0], StimulusLostError)
    records = read_records(folder / "S1.jsonl")[0]
    assert records[-1]["record"] == "discarded" and "its cable was cut" in records[-1]["cause"]
    assert len(records[-1]["felt"]) == 1, "what was felt of it is on record"


@pytest.mark.parametrize("plan", [NO_STUDY, TIMED])
def test_words_that_are_no_answer_are_refused_and_stop_stops(folder, plan):
    with seated(folder, plan, Dies()) as (seat, errors):
        seat.reads("read this ")
        seat.type("next")
        seat.reads("'next' is not an answer: press Enter alone, or stop")
        seat.reads("read this ")
        seat.type("")
        if plan is TIMED:
            seat.reads("ready ")
            seat.type("")
        else:
            seat.reads("first one; Enter when you have ")
            seat.type("2")
            seat.reads("'2' is not an answer: press Enter alone, or stop")
        seat.reads("feel the first one")
        time.sleep(0.1)
        seat.type("Stop")
        typed = time.perf_counter()
        while not errors:
            assert time.perf_counter() - typed < 5.0, seat.screen
            time.sleep(0.005)
        assert time.perf_counter() - typed < 0.3
    assert isinstance(errors[0], KeyboardInterrupt) and "second one" not in seat.screen


QUESTIONS = ["read this ", "first one; Enter when you have ", "second one; Enter when you have ", "1 or 2? "]


@pytest.mark.parametrize("n_answered", range(4))
def test_stop_stops_at_every_question(folder, n_answered):
    with seated(folder, NO_STUDY, Dies()) as (seat, errors):
        for question in QUESTIONS[:n_answered]:
            seat.reads(question)
            seat.type("")
        seat.reads(QUESTIONS[n_answered])
        seat.type("stop")
        end = time.perf_counter() + 5.0
        while not errors:
            assert time.perf_counter() < end, seat.screen
            time.sleep(0.01)
    assert isinstance(errors[0], KeyboardInterrupt)


def test_what_is_no_terminal_is_refused(folder):
    (folder / "file").write_text("")
    with pytest.raises(
        OSError, match="file is not a terminal: expected the path that `jaxgrasp experiment screen` prints"
    ):
        OtherTerminal(str(folder / "file"))
