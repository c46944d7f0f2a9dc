"""Plans: what a file says, what it leaves out, and what no experiment can be."""

import tomllib

import pytest

from jaxgrasp.psychophysics.plan import METHODS, Plan, SessionPlan, StimulusPlan, load_plan, plan_of, plan_toml


@pytest.mark.parametrize("method", list(METHODS))
@pytest.mark.parametrize("kind", ["weight", "stiffness", "torque"])
def test_a_file_and_back(folder, method, kind):
    plan = Plan('a "name"', 7, StimulusPlan(kind), SessionPlan((200.0,)), method, METHODS[method]())
    (folder / "plan.toml").write_text(plan_toml(plan))
    assert load_plan(folder / "plan.toml") == plan


def test_what_is_left_out_is_the_papers_but_for_the_fingers():
    plan = plan_of({}, "plan")
    assert plan == Plan() and plan.session.references == (1.0, 2.0, 3.0) and plan.most_trials() == 4 + 120
    assert plan.intensities()[0] == 1.0 and plan.intensities()[-1] == pytest.approx(3.9)
    assert plan.session.feedback and plan.stimulus.unit == "N"
    assert plan.stimulus.fingers == ("index", "middle", "ring", "little") and plan.stimulus.phalanx == "distal"


@pytest.mark.parametrize(
    "text, message",
    [
        ("x = ", "is no TOML"),
        ("sed = 1", "has 'sed': did you mean 'seed'"),
        ("seed = 1.5", "seed is 1.5: expected a whole number"),
        ("name = 3", "name is 3: expected text"),
        ("stimulus = 3", "stimulus is 3: expected a table"),
        ("procedure = 3", "procedure is 3: expected a table"),
        ('[stimulus]\nkind = "heat"', "stimulus.kind is 'heat': expected one of weight, stiffness, torque"),
        ('[stimulus]\nfingers = ["thumb"]', r"fingers\[0\] is 'thumb'"),
        ("[stimulus]\nfingers = []", "fingers is empty"),
        ('[stimulus]\nfingers = "index"', "fingers is 'index': expected a list"),
        ('[session]\nreferences = [1, "2"]', r"session.references\[1\] is '2': expected a number"),
        ("[session]\nreferences = [nan]", r"session.references\[0\] is nan"),
        ("[session]\nfeedback = 1", "session.feedback is 1: expected true or false"),
        ("[session]\npractice = -1", "session: practice is -1: expected 0 or more"),
        ("[session]\nduration = 0.3", "session: least_interval is 0.5: expected at most duration, 0.3 s"),
        ("[session]\nleast_movement = 91", "session: least_movement is 91.0: expected 0 to 90 degrees"),
        ('[session]\nduration = 2\n[procedure]\nmethod = "matching"', "session.duration is 2: expected 0"),
        (
            f'[session]\nhint = """{"x" * 101}"""',
            "session: hint has 1 lines of up to 101 characters: expected one screen",
        ),
        ('[procedure]\nmethod = "guess"', "procedure.method is 'guess'"),
        ("[procedure]\nlevels = [0.1, -1]", r"procedure: levels\[1\] is -1"),
        ("[procedure]\nseries = true", "procedure.series is True: expected a whole number"),
        ('[procedure]\nmethod = "staircase"\nlevels = [0.1]', "procedure has 'levels'"),
    ],
)
def test_bad_files(folder, text, message):
    (folder / "plan.toml").write_text(text)
    with pytest.raises(ValueError, match=message):
        load_plan(folder / "plan.toml")


def test_toml_of_a_plan_is_toml():
    assert tomllib.loads(plan_toml(Plan()))["session"]["references"] == [1.0, 2.0, 3.0]
