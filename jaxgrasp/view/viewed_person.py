"""Person whose trials are shown: the page shows each question before the person is asked.

Text on the pages of an experiment: the subject's question and the experimenter's details.
"""

import math
from collections.abc import Callable
from enum import IntEnum

from jaxgrasp.psychophysics.person import Move, Person
from jaxgrasp.psychophysics.plan import QUESTIONS, UNITS
from jaxgrasp.psychophysics.session import LET_GO
from jaxgrasp.psychophysics.trial import Rendered, Trial
from jaxgrasp.report.look import INK, MUTED, number
from jaxgrasp.view.view_slots import TrialState


class Phase(IntEnum):
    """Current activity of a person in an experiment."""

    WAITS = 0
    FEELS = 1
    CHOOSES = 2
    ADJUSTS = 3
    RESTS = 4
    REPEATS = 5
    LOST = 6


def subject_html(trial: TrialState, kind: str) -> str:
    """Return the subject's instruction or question, without any hint at the right answer."""
    match Phase(int(trial.phase)):
        case Phase.FEELS:
            instruction = f"Feel the {_stimulus_name(trial)} one."
        case Phase.CHOOSES:
            instruction = f"Which one was {QUESTIONS[kind]}, 1 or 2?"
        case Phase.ADJUSTS:
            instruction = "Make it feel the same: + or \N{MINUS SIGN}."
        case Phase.RESTS:
            instruction = "Rest."
        case Phase.REPEATS:
            instruction = "This one does not count. It is asked again."
        case Phase.LOST:
            instruction = "The glove let go: you feel nothing. Wait until it is armed again."
        case _:
            instruction = "It is about to begin."
    progress = f"trial {trial.number:.0f} of {trial.most:.0f} at most" if math.isfinite(trial.number) else ""
    return (
        f'<div data-asked style="font: 600 22px/1.35 system-ui, sans-serif;color:{INK};padding:12px">'
        f"{instruction}</div>"
        f'<div style="font: 14px/1.4 system-ui, sans-serif;color:{MUTED};padding:0 12px 12px">{progress}</div>'
    )


def _stimulus_name(trial: TrialState) -> str:
    """Return the name of the stimulus that the person feels: reference, first or second."""
    return "reference" if math.isfinite(trial.setting) else "first" if trial.interval == 1 else "second"


def experimenter_html(trial: TrialState, kind: str) -> str:
    """Return all details of a trial: rendered stimuli, the right answer, and the number of right answers."""
    phase = Phase(int(trial.phase))
    rows = [("just now", f"feels the {_stimulus_name(trial)}" if phase == Phase.FEELS else phase.name.lower())]
    if math.isfinite(trial.number):
        rows.append(("trial", f"{trial.number:.0f} of {trial.most:.0f} at most"))
        rows.append(("first", f"{number(trial.first)} {UNITS[kind]}"))
        rows.append(("second", f"{number(trial.second)} {UNITS[kind]}"))
        if math.isfinite(trial.setting):
            rows.append(("set to", f"{number(trial.setting)} {UNITS[kind]}"))
        else:
            rows.append((QUESTIONS[kind], "the first" if trial.first > trial.second else "the second"))
    if trial.answered:
        rows.append(("right so far", f"{trial.right:.0f} of {trial.answered:.0f}"))
    cells = "".join(f'<tr><td style="color:{MUTED};padding-right:12px">{a}</td><td>{b}</td></tr>' for a, b in rows)
    return f'<table data-trial style="font: 13px/1.5 system-ui, sans-serif;color:{INK};margin:6px 12px">{cells}</table>'


class ViewedPerson(Person):
    """Wrapper of a person that passes on the answers and updates the text of the pages."""

    def __init__(self, person: Person, max_trials: int):
        """Wrap a person; ``most`` is the largest number of trials."""
        self.observer = person.observer
        self._person, self._max_trials = person, max_trials
        self.state = TrialState()

    @property
    def is_lost(self) -> Callable[[], bool]:
        """Return the wrapped person's function."""
        return self._person.is_lost

    @is_lost.setter
    def is_lost(self, is_lost: Callable[[], bool]) -> None:
        self._person.is_lost = is_lost

    def ask_consent(self, text: str) -> bool:
        return self._person.ask_consent(text)

    def ask_question(self, question: str) -> str:
        return self._person.ask_question(question)

    def show_instructions(self, text: str) -> None:
        self._person.show_instructions(text)

    def wait_until_ready(self, trial: Trial) -> None:
        self._person.wait_until_ready(trial)

    def feel(self, trial: Trial, interval: int, duration_s: float) -> None:
        self._begins(Phase.FEELS, trial, float(interval))
        self._person.feel(trial, interval, duration_s)

    def pause(self, seconds: float) -> None:
        self._person.pause(seconds)

    def announce_repeat(self, reason: str) -> None:
        self.state = self.state._replace(phase=float(Phase.LOST if reason == LET_GO else Phase.REPEATS))
        self._person.announce_repeat(reason)

    def choose(self, trial: Trial, rendered: tuple[Rendered, Rendered]) -> int:
        self._begins(Phase.CHOOSES, trial)
        choice = self._person.choose(trial, rendered)
        right = float(choice == trial.stronger)
        self.state = self.state._replace(
            phase=Phase.WAITS, answered=self.state.answered + 1, right=self.state.right + right
        )
        return choice

    def adjust(self, trial: Trial, setting: float) -> Move:
        self._begins(Phase.ADJUSTS, trial, setting=setting)
        return self._person.adjust(trial, setting)

    def show_outcome(self, trial: Trial, is_right: bool) -> None:
        self._person.show_outcome(trial, is_right)

    def take_break(self, n_done: int, max_trials: int) -> None:
        self.state = self.state._replace(phase=Phase.RESTS)
        self._person.take_break(n_done, max_trials)

    def _begins(self, phase: Phase, trial: Trial, interval: float = math.nan, setting: float = math.nan) -> None:
        if trial.task == "setting" and math.isnan(setting):
            setting = trial.second
        self.state = self.state._replace(
            phase=float(phase),
            number=float(trial.number),
            most=float(self._max_trials),
            interval=interval,
            first=trial.first,
            second=trial.second,
            setting=setting,
        )
