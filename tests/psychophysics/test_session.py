"""Running an experiment: every answer is on disk before the next question, whatever happens to the program."""

import errno
import json
import os
import random
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest

from jaxgrasp.psychophysics import session
from jaxgrasp.psychophysics.analysis.cell import AnalysisSettings
from jaxgrasp.psychophysics.analysis.experiment import analyse, load_experiment
from jaxgrasp.psychophysics.person import SimulatedPerson
from jaxgrasp.psychophysics.plan import METHODS, Plan, SessionPlan
from jaxgrasp.psychophysics.procedures import ConstantStimuli, Matching
from jaxgrasp.psychophysics.psychometric import Observer, PsychometricShape
from jaxgrasp.psychophysics.records import Journal, RecordError, read_records
from jaxgrasp.psychophysics.schedule import Schedule
from jaxgrasp.psychophysics.session import run_experiment
from jaxgrasp.psychophysics.trial import IdealStimulus, NotFeltError, PredictedStimulus, Rendered

SHORT = Plan(session=SessionPlan(references=(1.0, 3.0), practice=2, break_every=7), procedure=ConstantStimuli(series=1))


class Watched(SimulatedPerson):
    """Counts what it is told and asked, and leaves when it is told to."""

    def __init__(self, plan: Plan, leaves_after: int = 10**9) -> None:
        super().__init__(Observer(0.15), plan.seed, "S1")
        self.answers, self.rests, self.heard, self._left = 0, [], [], leaves_after

    def choose(self, trial, rendered):
        if self.answers >= self._left:
            raise KeyboardInterrupt
        self.answers += 1
        return super().choose(trial, rendered)

    def show_outcome(self, trial, right):
        self.heard.append((trial.number, right))

    def take_break(self, done, most):
        self.rests.append(done)


def run(plan: Plan, folder: Path, person=None, **options) -> int:
    person = Watched(plan) if person is None else person
    return run_experiment(plan, "S1", folder, IdealStimulus(), person, **options)


def lasting(folder: Path) -> list[dict]:
    """Return all recorded trials without their times."""
    trials = load_experiment(folder).trials["S1"]
    return [
        {key: value for key, value in trial.items() if key not in ("at", "seconds", "durations")} for trial in trials
    ]


@pytest.mark.parametrize("method", list(METHODS))
def test_records_are_what_was_asked(folder, method):
    plan = replace(SHORT, method=method, procedure=METHODS[method]())
    count = run(plan, folder)
    trials = lasting(folder)
    assert len(trials) == count and [trial["number"] for trial in trials] == list(range(1, count + 1))
    schedule = Schedule(plan, "S1")
    for record in trials:
        trial = schedule.next()
        assert (trial.level, trial.first, trial.second) == (record["level"], record["first"], record["second"])
        if trial.task == "choice":
            assert record["right"] == (record["answer"] == trial.stronger)
            schedule.score(float(record["right"]))
        else:
            assert record["setting"] >= 0
            schedule.score(record["setting"] / record["reference"] - 1)
    assert schedule.next() is None


def test_rests_and_feedback(folder):
    person = Watched(SHORT)
    assert run(SHORT, folder, person) == 18
    assert person.rests == [9, 16] and [number for number, _ in person.heard] == list(range(1, 19))
    silent = replace(SHORT, session=replace(SHORT.session, feedback=False))
    silent_person = Watched(silent)
    run_experiment(silent, "S2", folder / "silent", IdealStimulus(), silent_person)
    with pytest.raises(RecordError, match=r"S1.jsonl was begun with another plan: session was .* and now is"):
        run_experiment(silent, "S3", folder, IdealStimulus(), silent_person)
    assert [number for number, _ in silent_person.heard] == [1, 2], "practice has feedback"


@pytest.mark.parametrize("method", list(METHODS))
def test_cut_off_anywhere_and_resumed(folder, method):
    """After a power failure at any byte, complete records stay and the end is that of an uninterrupted run."""
    procedure = Matching(trials=4) if method == "matching" else METHODS[method]()
    plan = replace(SHORT, session=SessionPlan((2.0,), practice=1), method=method, procedure=procedure)
    run(plan, folder)
    expected, data = lasting(folder), (folder / "S1.jsonl").read_bytes()
    begin = data.index(b"\n") + 1
    for cut in random.Random(0).sample(range(begin, len(data)), 25):
        (folder / "S1.jsonl").write_bytes(data[:cut])
        run(plan, folder, resume=True)
        assert lasting(folder) == expected
        records, remainder = read_records(folder / "S1.jsonl")
        torn = data[:cut].rpartition(b"\n")[2].decode()
        # What lacks its end of line alone is whole.
        lost = [torn] if torn and not torn.endswith("}") else []
        assert not remainder and [r["text"] for r in records if r["record"] == "cut-off"] == lost


def test_stopped_and_resumed(folder):
    run(SHORT, folder)
    expected = lasting(folder)
    (folder / "S1.jsonl").unlink()
    for answers in (3, 0, 5):
        with pytest.raises(KeyboardInterrupt):
            run(SHORT, folder, Watched(SHORT, answers), resume=True)
    assert len(lasting(folder)) == 8
    run(SHORT, folder, resume=True)
    assert lasting(folder) == expected


@pytest.mark.parametrize("kills", [6, pytest.param(200, marks=pytest.mark.slow)])
@pytest.mark.skipif(os.name != "posix", reason="needs SIGKILL")
def test_killed_at_random(folder, kills):
    """No answer that was said to be on record is lost, none is there twice, and the order is the same."""
    # Long enough that no run comes to its end before it is killed.
    series = min(100 * kills, 4000)
    program = [sys.executable, str(Path(__file__).with_name("experiment_to_kill.py")), str(folder), "S1", str(series)]
    rng, acknowledged = random.Random(0), 0
    for _ in range(kills):
        with subprocess.Popen(program, stdout=subprocess.PIPE, text=True) as process:
            last = int(process.stdout.readline())
            assert last == acknowledged + 1, "it goes on where the records end"
            for _ in range(rng.randrange(30)):
                last = int(process.stdout.readline())
            process.send_signal(signal.SIGKILL)
            lines = [line for line in process.stdout.read().splitlines(keepends=True) if line.endswith("\n")]
            last = int(lines[-1]) if lines else last
        numbers = [record["number"] for record in read_after_a_crash(folder / "S1.jsonl")]
        assert numbers == list(range(1, len(numbers) + 1)) and len(numbers) >= last
        acknowledged = len(numbers)
    schedule = Schedule(Plan(procedure=ConstantStimuli(series=series)), "S1")
    for record in read_after_a_crash(folder / "S1.jsonl"):
        trial = schedule.next()
        assert (record["number"], record["level"], record["first"]) == (trial.number, trial.level, trial.first)
        schedule.score(float(record["right"]))


def read_after_a_crash(path: Path) -> list[dict]:
    """Read the trials without the program's own reader."""
    lines = path.read_bytes().split(b"\n")[:-1]
    return [record for record in map(json.loads, lines) if record["record"] == "trial"]


def test_what_saturates_is_flagged(folder):
    class Weak(PredictedStimulus):
        def predict(self, intensity):
            return Rendered(intensity, min(intensity, 3.2), 0.05 * intensity, intensity > 3.2)

    run_experiment(SHORT, "S1", folder, Weak(), Watched(SHORT))
    for trial in lasting(folder):
        assert trial["saturated"] == (max(trial["first"], trial["second"]) > 3.2) and max(trial["felt"]) <= 3.2


class Hasty(Watched):
    """A person, whose second trial's second interval is too short the first time."""

    def __init__(self, plan: Plan) -> None:
        super().__init__(plan)
        self.observer, self.felt = None, []

    def feel(self, trial, interval, lasts):
        self.felt.append((trial.number, interval))
        hurries = trial.number == 2 and self.felt.count((2, 2)) == 1 and interval == 2
        time.sleep(0.0 if hurries else 0.03)


def test_a_trial_that_was_too_short_is_discarded_on_record_and_asked_again(folder):
    plan = replace(SHORT, session=replace(SHORT.session, least_interval=0.02))
    with pytest.raises(NotFeltError, match=r"felt for 0.0\d s: take at least 0.02 s"):
        run(plan, folder, Hasty(plan))
    (folder / "S1.jsonl").unlink()
    messages, hasty = [], Hasty(plan)
    count = run(plan, folder, hasty, lost=lambda error: messages.append(str(error)))
    assert len(messages) == 1 and hasty.felt[2:6] == [(2, 1), (2, 2), (2, 1), (2, 2)]
    records = read_records(folder / "S1.jsonl")[0]
    kinds = [record["record"] for record in records]
    assert kinds == ["begun", "trial", "discarded", *["trial"] * (count - 1)]
    discarded, again = records[2:4]
    assert discarded["cause"] == messages[0] and discarded["seconds"] > 0.02
    assert all(discarded[key] == again[key] for key in ("number", "level", "first", "second"))
    assert min(min(record["durations"]) for record in records if record["record"] == "trial") >= 0.02
    assert [trial["number"] for trial in lasting(folder)] == list(range(1, count + 1))


class Still(PredictedStimulus):
    """Whose hand does not move, and feels nothing whole, the first time."""

    def __init__(self, **first) -> None:
        super().__init__()
        self._left = [first]

    def predict(self, intensity):
        measured = {"motion_deg": 30.0, "full_intensity_s": 1.0} | (self._left.pop() if self._left else {})
        return Rendered(intensity, intensity, intensity, False, **measured)


@pytest.mark.parametrize(
    "first, message",
    [
        ({"motion_deg": 1.5}, "the hand moved by 1.5 degrees: expected at least 5"),
        ({"full_intensity_s": 0.1}, "it was felt at full intensity for 0.10 s: expected at least 0.2 s"),
    ],
)
def test_a_still_hand_is_told_what_to_do_and_asked_again(folder, first, message):
    class Reader(Watched):
        messages = ()

        def show_instructions(self, text):
            self.messages += (text,)

        def announce_repeat(self, why):
            self.messages += (why,)

    plan = replace(SHORT, session=replace(SHORT.session, least_interval=0.0, hint="Lift it."))
    person = Reader(plan)
    person.observer = None
    run_experiment(plan, "S1", folder, Still(**first), person, lost=lambda error: None)
    assert "Bend your fingers at the knuckles to lift" in person.messages[0] and "type 1 or 2" in person.messages[0]
    assert person.messages[1:] == (f"{message}.\nLift it.",)
    discarded, trial = read_records(folder / "S1.jsonl")[0][1:3]
    assert discarded["cause"] == message and discarded["moved"] == [first.get("motion_deg", 30.0)]
    assert trial["moved"] == [30.0, 30.0] and trial["whole"] == [1.0, 1.0] and trial["number"] == 1


def test_stimuli_of_a_fixed_duration(folder, monkeypatch):
    """Each lasts as the plan says, with the pause between, and begins when the person is ready."""

    class Timed(Watched):
        """Who alone moves the clock on, so that what is measured is what was felt, however busy the machine is."""

        def __init__(self, plan):
            super().__init__(plan)
            self.observer, self.came, self.now = None, [], 0.0

        def wait_until_ready(self, trial):
            self.came.append("ready")

        def feel(self, trial, interval, lasts):
            self.came.append((interval, lasts))
            self.now += lasts

        def pause(self, seconds):
            self.came.append(seconds)
            self.now += seconds

    timed = replace(SHORT.session, duration=0.02, pause=0.3, least_interval=0.01, least_whole=0.0, practice=0)
    plan = replace(SHORT, session=timed)
    person = Timed(plan)
    monkeypatch.setattr(session, "time", SimpleNamespace(perf_counter=lambda: person.now))
    count = run(plan, folder, person)
    assert person.came == ["ready", (1, 0.02), 0.3, (2, 0.02)] * count
    for record in read_records(folder / "S1.jsonl")[0][1:]:
        assert record["durations"] == [0.02, 0.02], "the pause is of neither"


def test_refusals(folder, unchecked):
    for subject in ("", "Jane Doe", "a/b", "x" * 33):
        with pytest.raises(ValueError, match="expected a code of letters"):
            run_experiment(SHORT, subject, folder, IdealStimulus(), Watched(SHORT))
    run(SHORT, folder)
    with pytest.raises(ValueError, match="already exists: add --resume"):
        run(SHORT, folder)
    with pytest.raises(RecordError, match="begun with another plan: seed was 2003, and now is 1"):
        run(replace(SHORT, seed=1), folder, resume=True)
    (folder / "S2.jsonl").write_bytes((folder / "S1.jsonl").read_bytes())
    with pytest.raises(RecordError, match="is of subject 'S1': expected 'S2'"):
        run_experiment(SHORT, "S2", folder, IdealStimulus(), Watched(SHORT), resume=True)


def changed(line: bytes, **values) -> bytes:
    return json.dumps(json.loads(line) | values).encode() + b"\n"


def test_records_that_are_not_those_of_the_plan(folder):
    """Records changed by hand are named by trial and field, neither resumed nor analysed, and left as they are."""
    run(SHORT, folder)
    path = folder / "S1.jsonl"
    first, second, two, *remainder = path.read_bytes().splitlines(keepends=True)
    wrong = not json.loads(second)["right"]
    for spoilt, message in (
        ([first, b"what?\n", two, *remainder], "line 2, is not a record: b'what"),
        ([first, b"[" * 100_000 + b"\n", two, *remainder], "line 2, is not a record"),
        ([first, two, *remainder], "trial 1: number is 2, and the plan leads to 1"),
        ([first, second, second, two, *remainder], "trial 2: number is 1"),
        ([first, two, second, *remainder], "trial 1: number is 2"),
        ([first, changed(second, level="0.3")], "trial 1: level is '0.3'"),
        ([first, changed(second, right=wrong)], "trial 1: right is .*, and the answer was"),
        ([first, changed(second, right=None)], "trial 1: right is None"),
        ([first, changed(second, answer=3)], "trial 1: answer is 3: expected 1 or 2"),
        ([first, changed(second, saturated=None)], "trial 1: saturated is None"),
        ([first, changed(second, felt=[1])], r"trial 1: felt is \[1\]: expected two numbers"),
        ([first, changed(second, whole=3)], "trial 1: whole is 3: expected two numbers"),
        ([first, changed(second, moved="ab")], "trial 1: moved is 'ab': expected two numbers"),
        ([second, two], "no first record"),
        ([changed(first, format=9), second], "has format 9: expected 1"),
        ([changed(first, plan=[1]), second], "has no plan in its first record"),
        ([changed(first, plan={"seed": "x"}), second], "seed is 'x'"),
        ([changed(first, subject="S2"), second], "is of subject 'S2': expected 'S1'"),
    ):
        path.write_bytes(b"".join(spoilt))
        with pytest.raises(RecordError, match=message):
            run(SHORT, folder, resume=True)
        with pytest.raises(RecordError, match=message):
            load_experiment(folder)
        assert path.read_bytes() == b"".join(spoilt), "nothing is touched"
    path.write_bytes(b"".join([first, second, two, *remainder]))
    (folder / "copy of S1.jsonl").write_bytes(path.read_bytes())
    with pytest.raises(RecordError, match="is of subject 'S1': expected 'copy of S1'"):
        load_experiment(folder)


def test_whatever_is_left_of_a_beginning(folder):
    """An empty file, a part of the first record, or a last record that lacks its end of line alone."""
    run(SHORT, folder)
    path = folder / "S1.jsonl"
    expected, data = lasting(folder), path.read_bytes()
    for left, count in ((b"", 0), (data[:40], 0), (data.splitlines()[0], 0), (data[:-1], len(expected))):
        path.write_bytes(left)
        assert len(lasting(folder)) == count if b"begun" in left and left.endswith(b"}") else True
        run(SHORT, folder, resume=True)
        assert lasting(folder) == expected and path.read_bytes().endswith(b"\n")


def test_a_setting_is_what_was_last_felt_beside_the_reference(folder):
    """Up, up, back to the reference, and done there."""

    class Weak(PredictedStimulus):
        def predict(self, intensity):
            return Rendered(intensity, min(intensity, 1.0), intensity, intensity > 1.0)

    class Certain(Watched):
        def adjust(self, trial, setting):
            self.heard.append(setting)
            return ("up", "up", "reference", "done")[(len(self.heard) - 1) % 4]

    plan = replace(SHORT, session=SessionPlan((1.0,), practice=2), method="matching", procedure=Matching(trials=4))
    run_experiment(plan, "S1", folder, Weak(), Certain(plan))
    for trial in lasting(folder):
        assert trial["setting"] == pytest.approx(trial["second"] + 0.04) and trial["first"] == 1.0
        assert trial["torque"][1] == pytest.approx(trial["setting"]) and trial["saturated"] == (trial["setting"] > 1)
    (match,) = analyse(load_experiment(folder)).matched
    assert match.saturated == 2 == match.settings
    (with_saturated,) = analyse(load_experiment(folder), AnalysisSettings(saturated="include")).matched
    assert with_saturated.settings == 4 and with_saturated.error != match.error


def test_lines_through_answers_that_chose_their_levels(folder):
    """Points of a staircase are where answers led: a straight line through them means nothing."""
    plan = replace(SHORT, method="staircase", procedure=METHODS["staircase"]())
    run(plan, folder)
    with pytest.raises(ValueError, match="levels of the procedure 'staircase' follow the answers"):
        analyse(load_experiment(folder), AnalysisSettings("line"))
    assert analyse(load_experiment(folder)).settings.model.shape is PsychometricShape.DIFFERENCE


def test_what_was_too_brief_to_be_felt_is_said(folder):
    plan = replace(SHORT, session=replace(SHORT.session, least_interval=0.0))
    person = Watched(plan)
    person.observer = None
    run(plan, folder, person)
    with pytest.raises(RecordError, match="was begun by a person, and now it is a simulated observer"):
        run(plan, folder, resume=True)
    notes = analyse(load_experiment(folder)).notes
    assert any("S1: 16 trials had an interval of less than 0.3 s" in note for note in notes)
    (folder / "S1.jsonl").unlink()
    run(plan, folder)
    assert any("S1: answers of a simulated observer" in note for note in analyse(load_experiment(folder)).notes)


def test_a_full_disk_is_said_with_the_file_and_what_goes_on(folder, monkeypatch):
    synced, sync = [], os.fsync

    def full(number):
        synced.append(number)
        if len(synced) > 6:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        sync(number)

    with monkeypatch.context() as patched:
        patched.setattr(os, "fsync", full)
        with pytest.raises(
            OSError, match=r"S1.jsonl cannot be written: No space left .*; all earlier answers are in it"
        ):
            run(SHORT, folder)
    run(SHORT, folder, resume=True)
    assert [trial["number"] for trial in lasting(folder)] == list(range(1, 19))


def test_one_program_at_a_time(folder):
    with Journal(folder / "S1.jsonl", {"record": "begun"}), pytest.raises(OSError, match="in use by another program"):
        Journal(folder / "S1.jsonl", {"record": "begun"})
    with Journal(folder / "S1.jsonl", {"record": "begun"}) as journal:
        with pytest.raises(ValueError, match="not JSON compliant"):
            journal.append({"record": "trial", "felt": float("nan")})
        assert len(journal.records) == 1
