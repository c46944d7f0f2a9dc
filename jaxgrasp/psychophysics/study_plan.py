"""Study of an experiment: investigator, consent, and the questions to each person before the first trial."""

import re
from dataclasses import dataclass

from jaxgrasp.psychophysics.screen import check_screen

QUESTION = re.compile(r"[a-z][a-z0-9_]{0,31}")
MOST_QUESTIONS = 20


@dataclass(frozen=True)
class StudyPlan:
    """Study data of every person's records beside the answers."""

    title: str = ""
    investigator: str = ""
    institution: str = ""
    ethics: str = ""
    """Number of the approval by an ethics committee."""
    consent: str = ""
    """Text that a person has to agree to before the first trial, a screen at most; not asked where it is empty."""
    questions: tuple[str, ...] = ()
    """Questions to each person, kept beside the answers, such as `age` or `hand`: names of columns; never ask for the
    name of a person."""

    def __post_init__(self):
        check_screen("consent", self.consent)
        if len(self.questions) > MOST_QUESTIONS:
            raise ValueError(f"questions has {len(self.questions)} entries: expected at most {MOST_QUESTIONS}")
        for k, question in enumerate(self.questions):
            if not QUESTION.fullmatch(question):
                raise ValueError(
                    f"questions[{k}] is {question!r}: expected a column name of lower-case letters, digits and _"
                )
            if question in self.questions[:k]:
                raise ValueError(f"questions[{k}] is {question!r} again: expected each question once")
