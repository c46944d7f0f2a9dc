"""A person at a terminal, who answers by the keyboard."""

from jaxgrasp.cli.terminal import show, typed
from jaxgrasp.psychophysics.plan import QUESTIONS, Plan
from jaxgrasp.psychophysics.running.person import Move, Person
from jaxgrasp.psychophysics.stimulus import Rendered
from jaxgrasp.psychophysics.trial import Trial

MOVES: dict[str, Move] = {"+": "up", "-": "down", "r": "reference", "c": "comparison", "": "done"}


class TerminalPerson(Person):
    """Asks by lines of text; the end of the input interrupts the experiment, and nothing is lost."""

    def __init__(self, plan: Plan) -> None:
        self._plan, self._most = plan, plan.most_trials()
        self._started = False

    def feel(self, trial: Trial, interval: int) -> None:
        if interval == 1:
            what = "practice" if trial.is_practice else f"session {trial.session}"
            show(f"\ntrial {trial.number} of {self._most} ({what})")
            self._started = False
        name = "reference" if trial.task == "setting" else ("first", "second")[interval - 1]
        typed(f"  feel the {name} one; Enter when you have ")

    def choose(self, trial: Trial, rendered: tuple[Rendered, Rendered]) -> int:
        while True:
            answer = typed(f"  which one was {QUESTIONS[self._plan.stimulus.kind]}, 1 or 2? ").strip()
            if answer in ("1", "2"):
                return int(answer)

    def adjust(self, trial: Trial, setting: float) -> Move:
        if not self._started:
            show("  make the other one feel the same: + or -, r for the reference, c to come back, Enter when it does")
            self._started = True
        while True:
            answer = typed("  > ").strip().lower()
            if answer in MOVES:
                return MOVES[answer]

    def told(self, trial: Trial, right: bool) -> None:
        show("  right" if right else "  wrong")

    def rest(self, done: int, most: int) -> None:
        typed(f"\n{done} of at most {most} trials are done. Rest; Enter to go on ")
