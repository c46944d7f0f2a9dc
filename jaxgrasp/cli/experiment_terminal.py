"""The person of an experiment at a terminal: this one, or one beside it."""

import os
import sys
import time

from jaxgrasp.cli.experiment_arguments import Screen
from jaxgrasp.cli.terminal import CLEARED, Terminal, forget_typed_ahead, show
from jaxgrasp.files.printable import printable_lines
from jaxgrasp.psychophysics.person import Move, Person
from jaxgrasp.psychophysics.plan import QUESTIONS, Plan
from jaxgrasp.psychophysics.trial import Rendered, Trial

MOVES: dict[str, Move] = {"+": "up", "-": "down", "r": "reference", "c": "comparison", "": "done"}


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
        while (answer := self._terminal.typed("\nDo you agree? yes or no: ").strip().lower()) not in ("yes", "no"):
            pass
        return answer == "yes"

    def ask_question(self, question: str) -> str:
        return self._terminal.typed(f"{question.replace('_', ' ')} (Enter for no answer): ").strip()

    def show_instructions(self, text: str) -> None:
        self._terminal.clear()
        self._terminal.show(text)
        self._terminal.typed("\nEnter when you have read this ")
        self._terminal.clear()

    def wait_until_ready(self, trial: Trial) -> None:
        self._numbered(trial)
        self._terminal.typed("  Enter when you are ready ")

    def feel(self, trial: Trial, interval: int, duration_s: float) -> None:
        if interval == 1:
            self._started = False
            if not duration_s:
                self._numbered(trial)
        name = "reference" if trial.task == "setting" else ("first", "second")[interval - 1]
        if duration_s:
            self._terminal.show(f"  feel the {name} one")
            time.sleep(duration_s)
        else:
            self._terminal.typed(f"  feel the {name} one; Enter when you have ")

    def pause(self, seconds: float) -> None:
        self._terminal.show("  wait")
        time.sleep(seconds)

    def announce_repeat(self, reason: str) -> None:
        self._terminal.show(f"\nThis trial does not count: {reason}")

    def choose(self, trial: Trial, rendered: tuple[Rendered, Rendered]) -> int:
        while True:
            answer = self._terminal.typed(f"  which one was {QUESTIONS[self._plan.stimulus.kind]}, 1 or 2? ").strip()
            if answer in ("1", "2"):
                return int(answer)

    def adjust(self, trial: Trial, setting: float) -> Move:
        if not self._started:
            self._terminal.show(
                "  make the other one feel the same: + or -, r for the reference, c to come back, Enter when it does"
            )
            self._started = True
        while True:
            answer = self._terminal.typed("  > ").strip().lower()
            if answer in MOVES:
                return MOVES[answer]

    def show_outcome(self, trial: Trial, is_right: bool) -> None:
        self._terminal.show("  right" if is_right else "  wrong")

    def take_break(self, n_done: int, max_trials: int) -> None:
        self._terminal.typed(f"\n{n_done} {self._of} trials are done. Rest; Enter to go on ")

    def _numbered(self, trial: Trial) -> None:
        part = "practice" if trial.is_practice else f"session {trial.session}"
        self._terminal.show(f"\ntrial {trial.number} {self._of} ({part})")


LONGEST = 4096
"""Bytes of a line that a terminal hands over at most."""


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

    def show(self, text: str) -> None:
        self._put(printable_lines(text) + "\n")

    def typed(self, prompt: str) -> str:
        forget_typed_ahead(self._number)
        self._put(prompt)
        try:
            line = os.read(self._number, LONGEST)
        except OSError:
            # Its window was closed.
            line = b""
        if not line:
            raise KeyboardInterrupt
        return line.decode(errors="replace").rstrip("\n")

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
