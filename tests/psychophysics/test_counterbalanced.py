"""Orders that are counterbalanced over persons, and what a study asks beside the answers."""

import itertools
from collections import Counter
from dataclasses import replace

import pytest

from jaxgrasp.psychophysics.person import SimulatedPerson
from jaxgrasp.psychophysics.plan import Plan, SessionPlan, StudyPlan
from jaxgrasp.psychophysics.procedures import ConstantStimuli
from jaxgrasp.psychophysics.psychometric import Observer
from jaxgrasp.psychophysics.records import read_records
from jaxgrasp.psychophysics.schedule import Schedule, balanced_latin_square
from jaxgrasp.psychophysics.session import NoConsentError, run_experiment
from jaxgrasp.psychophysics.trial import IdealStimulus


@pytest.mark.parametrize("count", range(1, 12))
def test_each_condition_stands_in_each_place_and_after_each_other_equally_often(count):
    rows = balanced_latin_square(count)
    assert len(rows) == (count if count % 2 == 0 else 2 * count)
    places = Counter((place, condition) for row in rows for place, condition in enumerate(row))
    after = Counter(pair for row in rows for pair in itertools.pairwise(row))
    assert len(places) == count**2 and set(places.values()) == {len(rows) // count}
    assert len(after) == count * (count - 1) and len(set(after.values())) <= 1


def test_persons_take_the_rows_in_turn():
    plan = Plan(session=SessionPlan((1.0, 2.0, 3.0, 4.0), order="balanced", sessions=2, practice=0))
    orders = [Schedule(plan, f"S{k:02d}").references for k in range(1, 9)]
    firsts = Counter((place, condition) for order in orders for place, condition in enumerate(order[:4]))
    assert set(firsts.values()) == {2} and len(firsts) == 16
    assert orders[0] == orders[4] and orders[0][4:] == orders[1][:4]
    assert Schedule(plan, "P-7").references == orders[6]
    for code in ("Sx", "S00"):
        with pytest.raises(ValueError, match=f"subject is '{code}', and the plan's orders are balanced"):
            Schedule(plan, code)


STUDY = StudyPlan(title="Weights", consent="I may stop at any time.", questions=("age", "hand"))
PLAN = Plan(
    session=SessionPlan((1.0,), practice=0, least_interval=0.0), procedure=ConstantStimuli(series=1), study=STUDY
)


class AskedPerson(SimulatedPerson):
    """A person who agrees or not, and says an age."""

    def __init__(self, agrees: bool = True, leaves: bool = False) -> None:
        super().__init__(Observer(), PLAN.seed, "S1")
        self.observer, self._agrees, self._leaves, self.heard = None, agrees, leaves, []

    def ask_consent(self, text):
        self.heard.append(text)
        return self._agrees

    def ask_question(self, question):
        self.heard.append(question)
        return "34" if question == "age" else ""

    def show_instructions(self, text):
        self.heard.append("instructions")
        if self._leaves:
            raise KeyboardInterrupt


def test_consent_comes_first_and_once(folder):
    with pytest.raises(NoConsentError, match="did not agree: nothing was asked"):
        run_experiment(PLAN, "S1", folder, IdealStimulus(), AskedPerson(agrees=False))
    assert [record["record"] for record in read_records(folder / "S1.jsonl")[0]] == ["begun", "consent"]
    first = AskedPerson(leaves=True)
    with pytest.raises(KeyboardInterrupt):
        run_experiment(PLAN, "S1", folder, IdealStimulus(), first, resume=True)
    assert first.heard == [STUDY.consent, "age", "hand", "instructions"]
    second = AskedPerson()
    run_experiment(PLAN, "S1", folder, IdealStimulus(), second, resume=True)
    assert second.heard == ["instructions"]
    (about,) = (record for record in read_records(folder / "S1.jsonl")[0] if record["record"] == "about")
    assert about["answers"] == {"age": "34", "hand": ""}


def test_an_observer_agrees_to_nothing(folder):
    run_experiment(PLAN, "S1", folder, IdealStimulus(), SimulatedPerson(Observer(), 1, "S1"))
    assert {record["record"] for record in read_records(folder / "S1.jsonl")[0]} == {"begun", "trial"}


@pytest.mark.parametrize(
    "questions, message", [(("Age",), r"questions\[0\] is 'Age'"), (("a", "a"), r"questions\[1\] is 'a' again")]
)
def test_bad_questions(questions, message):
    with pytest.raises(ValueError, match=message):
        replace(STUDY, questions=questions)
