"""The person of an experiment at a terminal: this one, or one beside it."""

import os
import sys
import time
from collections.abc import Callable, Collection

from jaxgrasp.cli.experiment_arguments import Screen
from jaxgrasp.cli.terminal import CLEARED, LineInput, Terminal, read_until, show, wait_until
from jaxgrasp.files.printable import printable_lines, shortened
from jaxgrasp.psychophysics.person import Move, Person
from jaxgrasp.psychophysics.plan import QUESTIONS, Plan
from jaxgrasp.psychophysics.trial import Rendered, Trial

MOVES: dict[str, Move] = {"+": "up", "-": "down", "r": "reference", "c": "comparison", "": "done"}
STOP = "stop"
"""Word that ends the experiment at any question."""
ENTER = ("",)
"""Only answer where the person says that something is done."""


def ask(
    terminal: Terminal,
    prompt: str,
    answers: Collection[str],
    expected: str,
    is_over: Callable[[], bool] | None = None,
) -> str | None:
    """Ask until one of the answers is typed, and return it; None where ``is_over`` returned True before.

    Args:
        terminal: of the person who is asked.
        prompt: the question.
        answers: in lower case.
        expected: the answers in words, for a person who typed another.
        is_over: ends the question.

    Raises:
        KeyboardInterrupt: for ``stop``, and at the end of the input.
    """
    while True:
        line = terminal.typed(prompt, is_over)
        if line is None:
            return None
        answer = line.strip().lower()
        if answer == STOP:
            raise KeyboardInterrupt
        if answer in answers:
            return answer
        terminal.show(f"  {shortened(answer) if answer else 'Enter alone'} is not an answer: {expected}, or {STOP}")


class TerminalPerson(Person):
    """Person at a terminal; the lines of text that ask tell neither intensities nor torques.

    The end of the input interrupts the experiment, and nothing is lost.
    """

    def __init__(self, plan: Plan, terminal: Terminal) -> None:
        self._plan, self._terminal = plan, terminal
        self._of = f"of {plan.at_most()}"
        self._started = False

    def ask_consent(self, text: str) -> bool:
        self._terminal.clear()
        self._terminal.show(text)
        return ask(self._terminal, "\nDo you agree? yes or no: ", ("yes", "no"), "type yes or no") == "yes"

    def ask_question(self, question: str) -> str:
        answer = (self._terminal.typed(f"{question.replace('_', ' ')} (Enter for no answer): ") or "").strip()
        if answer.lower() == STOP:
            raise KeyboardInterrupt
        return answer

    def show_instructions(self, text: str) -> None:
        self._terminal.clear()
        self._terminal.show(text)
        self._enter("\nEnter when you have read this ")
        self._terminal.clear()

    def wait_until_ready(self, trial: Trial) -> None:
        self._numbered(trial)
        self._enter("  Enter when you are ready ")

    def feel(self, trial: Trial, interval: int, duration_s: float) -> None:
        if interval == 1:
            self._started = False
            if not duration_s:
                self._numbered(trial)
        name = "reference" if trial.task == "setting" else ("first", "second")[interval - 1]
        if duration_s:
            self._terminal.show(f"  feel the {name} one")
            self._wait(duration_s)
        else:
            self._enter(f"  feel the {name} one; Enter when you have ", self.is_lost)

    def pause(self, seconds: float) -> None:
        self._terminal.show("  wait")
        self._wait(seconds)

    def announce_repeat(self, reason: str) -> None:
        self._terminal.show(f"\nThis trial does not count: {reason}")

    def choose(self, trial: Trial, rendered: tuple[Rendered, Rendered]) -> int:
        question = f"  which one was {QUESTIONS[self._plan.stimulus.kind]}, 1 or 2? "
        answer = ask(self._terminal, question, ("1", "2"), "type 1 or 2")
        assert answer is not None
        return int(answer)

    def adjust(self, trial: Trial, setting: float) -> Move:
        if not self._started:
            self._terminal.show(
                "  make the other one feel the same: + or -, r for the reference, c to come back, Enter when it does"
            )
            self._started = True
        answer = ask(self._terminal, "  > ", MOVES, "type + or -, r, c, or Enter alone", self.is_lost)
        return "done" if answer is None else MOVES[answer]

    def show_outcome(self, trial: Trial, is_right: bool) -> None:
        self._terminal.show("  right" if is_right else "  wrong")

    def take_break(self, n_done: int, max_trials: int) -> None:
        self._enter(f"\n{n_done} {self._of} trials are done. Rest; Enter to go on ")

    def _enter(self, prompt: str, is_over: Callable[[], bool] | None = None) -> None:
        """Wait for Enter alone, or until ``is_over`` returns True."""
        ask(self._terminal, prompt, ENTER, "press Enter alone", is_over)

    def _wait(self, seconds: float) -> None:
        """Wait for a time [s], or until the stimulus is lost; whoever types ``stop`` meanwhile ends the experiment."""
        end = time.perf_counter() + seconds
        while (line := self._terminal.wait(end - time.perf_counter(), self.is_lost)) is not None:
            if line.strip().lower() == STOP:
                raise KeyboardInterrupt

    def _numbered(self, trial: Trial) -> None:
        part = "practice" if trial.is_practice else f"session {trial.session}"
        self._terminal.show(f"\ntrial {trial.number} {self._of} ({part})")


class OtherTerminal(Terminal):
    """A terminal of the same machine by its device, such as ``/dev/pts/3`` (Linux, macOS)."""

    def __init__(self, path: str) -> None:
        """Open the terminal's device.

        Raises:
            OSError: for a path that cannot be opened, or is no terminal.
        """
        # It must not become the one that could interrupt this program.
        self._number = os.open(path, os.O_RDWR | getattr(os, "O_NOCTTY", 0))
        if not os.isatty(self._number):
            os.close(self._number)
            raise OSError(f"{path} is not a terminal: expected the path that `jaxgrasp experiment screen` prints")
        self._lines = LineInput(self._number)

    def show(self, text: str) -> None:
        self._put(printable_lines(text) + "\n")

    def typed(self, prompt: str, is_over: Callable[[], bool] | None = None) -> str | None:
        self._lines.forget_typed_ahead()
        self._put(prompt)
        return read_until(self._lines, is_over)

    def wait(self, seconds: float, is_over: Callable[[], bool]) -> str | None:
        return wait_until(seconds, is_over, self._lines)

    def clear(self) -> None:
        self._put(CLEARED)

    def close(self) -> None:
        """Close the terminal's device."""
        os.close(self._number)

    def _put(self, text: str) -> None:
        os.write(self._number, text.encode())


def screen_command(arguments: Screen) -> int:
    """Say which terminal this is, and leave its keyboard alone, until interrupted."""
    if os.name != "posix" or not sys.stdin.isatty():
        raise ValueError("another program cannot use this terminal: expected a terminal of Linux or macOS")
    show(
        f"This terminal is the person's. In another one: jaxgrasp experiment run ... --screen {os.ttyname(0)}\n"
        "It waits for that; Ctrl-C ends it."
    )
    while True:
        time.sleep(3600)
