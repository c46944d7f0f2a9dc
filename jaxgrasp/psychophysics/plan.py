"""Plan of an experiment from a TOML file: stimulus, references, procedure and study.

Texts that a person reads at once.

Study of an experiment: investigator, consent, and the questions to each person before the first trial.

Texts for a person: a screen before the first trial, and a hint where nothing was felt.
"""

import json
import os
import re
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any, Literal

from jaxgrasp.files.file_values import build_dataclass, load_toml, nearest
from jaxgrasp.paper.tables import REFERENCE_WEIGHTS
from jaxgrasp.psychophysics.procedures import (
    Adaptive,
    ConstantStimuli,
    Matching,
    Settings,
    Staircase,
    check_count,
    check_level,
)
from jaxgrasp.psychophysics.trial import intensity
from jaxgrasp.validation.checked import checked

LINES, CHARACTERS = 20, 100
"""Size of a screen, in lines and in characters of a line."""


def check_screen(name: str, text: str) -> None:
    """Raise ValueError for a text that a person would have to scroll."""
    lines = text.split("\n")
    longest = max(map(len, lines))
    if len(lines) > LINES or longest > CHARACTERS:
        raise ValueError(
            f"{name} has {len(lines)} lines of up to {longest} characters: expected one screen, {LINES} lines of up to "
            f"{CHARACTERS} characters"
        )


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


MOST_TRIALS = 100_000
MOST_INTERVAL = 60.0
MOST_MOVEMENT = 90.0
METHODS: dict[str, type[Settings]] = {
    "constant-stimuli": ConstantStimuli,
    "matching": Matching,
    "staircase": Staircase,
    "adaptive": Adaptive,
}
UNITS = {"weight": "N", "stiffness": "N/m", "torque": "N\N{MIDDLE DOT}m"}
FIG_8 = ("index", "middle")
"""The fingers of the paper's experiment."""
QUESTIONS = {"weight": "heavier", "stiffness": "stiffer", "torque": "stronger"}


@dataclass(frozen=True)
class StimulusPlan:
    """Kind of the stimulus, and the fingers or the joint that feel it."""

    kind: Literal["weight", "stiffness", "torque"] = "weight"
    """Weight or stiffness of a virtual object that is lifted or squeezed; or a torque on one joint."""
    fingers: tuple[str, ...] = ("index", "middle", "ring", "little")
    """Fingers that bear a weight or squeeze. The paper's are the index and the middle finger (Fig. 8), on whose tips
    its glove's 0.12 N.m bear no more than 2.7 N of the 3.9 N that its experiment asks for; four bear them all."""
    phalanx: Literal["distal", "middle", "proximal"] = "distal"
    """Part of those fingers that a weight lies on: nearer to the knuckles the same torque bears more of it, on fewer
    joints."""
    joint: str = "index MP"
    """Joint that a torque resists."""
    rendering: Literal["exact", "simulated"] = "exact"
    """Rendering of a weight: by a law that shares it alike among the fingers; or by the virtual hand's pipeline, as
    a plate that lies on them, with contacts, depths, and inertia as it is lifted."""

    def __post_init__(self):
        if self.phalanx != "distal" and self.kind != "weight":
            raise ValueError(f"phalanx is {self.phalanx!r}: expected 'distal' of a {self.kind}")
        if self.rendering != "exact" and self.kind != "weight":
            raise ValueError(f"rendering is {self.rendering!r}: expected 'exact' of a {self.kind}")
        if not self.fingers:
            raise ValueError("fingers is empty: expected at least one")
        for k, finger in enumerate(self.fingers):
            finger_names = ("index", "middle", "ring", "little")
            if finger not in finger_names:
                raise ValueError(f"fingers[{k}] is {finger!r}{nearest(finger, finger_names)}")
            if finger in self.fingers[:k]:
                raise ValueError(f"fingers[{k}] is {finger!r} again: expected each finger once")

    @property
    def unit(self) -> str:
        """Unit of the stimulus' intensity."""
        return UNITS[self.kind]


@dataclass(frozen=True)
class SessionPlan:
    """Sessions of a person: references, order, durations and texts."""

    references: tuple[float, ...] = REFERENCE_WEIGHTS
    """Reference intensities in the stimulus' unit; zero stands for detection: something against nothing."""
    sessions: int = 1
    """Sessions with each reference."""
    order: Literal["random", "given", "balanced"] = "random"
    """Order of the references: random; as given; or counterbalanced over persons by the rows of balanced Latin squares,
    of which a person's is found by the number that the code ends in: S01, S02, ..."""
    feedback: bool = True
    """True where a person is told if an answer was right."""
    practice: int = 4
    """Trials before the first session, at its largest level, with feedback."""
    break_every: int = 40
    """Trials after which a person is asked to rest."""
    duration: float = 0.0
    """Time for which each stimulus of a trial is rendered [s], the same for all; 0: until the person presses Enter."""
    pause: float = 0.0
    """Time without a stimulus between the two of a trial [s]."""
    least_interval: float = 0.5
    """Time for which a person has to feel each stimulus of a trial [s]; a shorter trial is asked again."""
    least_movement: float = 5.0
    """Angle by which one of the joints that feel a stimulus has to move meanwhile [degrees]; else asked again."""
    least_whole: float = 0.2
    """Time for which nine tenths of each stimulus have to be felt [s]; else the trial is asked again."""
    instructions: str = ""
    """Text for a person before the first trial, a screen at most; that of the stimulus where it is empty."""
    hint: str = ""
    """Text for a person whose hand did not move, a screen at most; that of the stimulus where it is empty."""

    def __post_init__(self):
        if not self.references:
            raise ValueError("references is empty: expected at least one")
        for k, reference in enumerate(self.references):
            if reference != 0:
                check_level(f"references[{k}]", reference)
            if reference in self.references[:k]:
                raise ValueError(f"references[{k}] is {reference:g} again: expected each reference once")
        for name in ("duration", "pause", "least_interval", "least_whole"):
            if not 0 <= getattr(self, name) <= MOST_INTERVAL:
                raise ValueError(f"{name} is {getattr(self, name)}: expected 0 to {MOST_INTERVAL:g} s")
        if not 0 <= self.least_movement <= MOST_MOVEMENT:
            raise ValueError(f"least_movement is {self.least_movement}: expected 0 to {MOST_MOVEMENT:g} degrees")
        for name in ("least_interval", "least_whole"):
            if 0 < self.duration < getattr(self, name):
                raise ValueError(f"{name} is {getattr(self, name)}: expected at most duration, {self.duration:g} s")
        for name in ("instructions", "hint"):
            check_screen(name, getattr(self, name))
        for name, least in (("sessions", 1), ("practice", 0), ("break_every", 1)):
            check_count(name, getattr(self, name), least)


FEEDBACKS = ("none", "force", "vibration", "both")
"""Conditions of the factor feedback: no feedback, torques, vibration in their place, or both."""
FACTORS = {"feedback": FEEDBACKS}
"""Factors within persons, each with the conditions that it may have."""


@dataclass(frozen=True)
class WithinPlan:
    """Factor of which every person meets all conditions; no factor by default."""

    factor: str = ""
    """Name of the factor; empty for none."""
    conditions: tuple[str, ...] = ()
    """Conditions of the factor, at least two."""

    def __post_init__(self):
        if self.factor and self.factor not in FACTORS:
            raise ValueError(f"factor is {self.factor!r}{nearest(self.factor, list(FACTORS))}")
        if not self.factor:
            if self.conditions:
                raise ValueError(
                    f"conditions is {list(self.conditions)} without a factor: expected factor = 'feedback'"
                )
            return
        if len(self.conditions) < 2:
            raise ValueError(f"conditions has {len(self.conditions)} entries: expected at least 2")
        known = FACTORS[self.factor]
        for k, condition in enumerate(self.conditions):
            if condition not in known:
                raise ValueError(f"conditions[{k}] is {condition!r}{nearest(condition, list(known))}")
            if condition in self.conditions[:k]:
                raise ValueError(f"conditions[{k}] is {condition!r} again: expected each condition once")

    @property
    def n_conditions(self) -> int:
        """Return the number of conditions that a person meets: 1 without a factor."""
        return max(len(self.conditions), 1)


def parse_within(text: str) -> WithinPlan:
    """Return the factor of a text such as ``feedback`` or ``feedback=force,vibration``; without conditions, all.

    Raises:
        ValueError: for a factor or a condition that is none of those known, or is given twice.
    """
    factor, _, conditions = text.partition("=")
    if not conditions:
        return WithinPlan(factor, FACTORS.get(factor, ()))
    return WithinPlan(factor, tuple(part.strip() for part in conditions.split(",")))


@dataclass(frozen=True)
class Plan:
    """A whole experiment. Its defaults are the paper's (section III-C), but for the fingers, which are all four."""

    name: str = "virtual weight"
    seed: int = 2003
    """Seed of all random orders, with each person's code."""
    stimulus: StimulusPlan = field(default_factory=StimulusPlan)
    session: SessionPlan = field(default_factory=SessionPlan)
    method: str = "constant-stimuli"
    procedure: Settings = field(default_factory=ConstantStimuli)
    study: StudyPlan = field(default_factory=StudyPlan)
    within: WithinPlan = field(default_factory=WithinPlan)

    def __post_init__(self):
        if self.within.factor and self.method != "constant-stimuli":
            raise ValueError(
                f"procedure.method is {self.method!r}, and within.factor is {self.within.factor!r}: expected "
                "constant-stimuli, whose shares of right answers are compared between conditions"
            )
        if self.method == "matching" and 0 in self.session.references:
            raise ValueError("session.references contains 0, which nothing can match: expected positive references")
        if self.most_trials() > MOST_TRIALS:
            raise ValueError(
                f"the plan has {self.most_trials():,} trials of a person: expected at most {MOST_TRIALS:,}"
            )
        if self.method == "matching" and self.session.duration:
            raise ValueError(
                f"session.duration is {self.session.duration:g}: expected 0, since the person ends a matching trial"
            )
        if self.is_detection and len(self.session.references) > 1:
            raise ValueError(
                "session.references contains 0 and other values: expected detection (0) in a plan of its own"
            )

    @property
    def is_detection(self) -> bool:
        """True where levels are intensities, since there is no reference."""
        return 0 in self.session.references

    def intensities(self) -> list[float]:
        """Return the intensities that are certain to come, or the ends of those that may come, in rising order."""
        levels = getattr(self.procedure, "levels", None)
        levels = levels if isinstance(levels, tuple) else self.procedure.extremes()
        references = {reference for reference in self.session.references if reference > 0}
        return sorted(references | {intensity(r, level) for r in self.session.references for level in levels})

    def most_trials(self) -> int:
        """Return the largest number of trials of a person, practice included."""
        sessions = self.session.sessions * len(self.session.references) * self.within.n_conditions
        return self.session.practice + sessions * self.procedure.most_trials()

    def at_most(self) -> str:
        """Return the largest number of trials in words, with "at most" for a staircase, which may end before."""
        return f"{'at most ' if self.method == 'staircase' else ''}{self.most_trials()}"

    def table(self) -> dict[str, Any]:
        """Return the plan as the tables of its TOML file."""
        tables = {"stimulus": _plain(self.stimulus), "session": _plain(self.session)}
        procedure = {"method": self.method, **_plain(self.procedure)}
        return {
            "name": self.name,
            "seed": self.seed,
            **tables,
            "procedure": procedure,
            "study": _plain(self.study),
            "within": _plain(self.within),
        }


@checked
def load_plan(path: str | os.PathLike) -> Plan:
    """Read the plan in a TOML file; settings that the file leaves out are the paper's.

    Raises:
        ValueError: for a file that is no TOML, keys that are unknown, and values that no experiment has.
        OSError: for a file that cannot be read.
    """
    return plan_of(load_toml(Path(path)), str(path))


def plan_of(table: dict[str, Any], source: str) -> Plan:
    """Build the plan from a table; ``source`` names the table in messages."""
    known_keys = [plan_field.name for plan_field in fields(Plan) if plan_field.name != "method"]
    for key in table:
        if key not in known_keys:
            raise ValueError(f"{source} has {key!r}{nearest(key, known_keys)}")
    name, seed = table.get("name", Plan.name), table.get("seed", Plan.seed)
    if not isinstance(name, str):
        raise ValueError(f"name is {name!r}: expected text")
    if isinstance(seed, bool) or not isinstance(seed, int):
        raise ValueError(f"seed is {seed!r}: expected a whole number")
    stimulus = build_dataclass(StimulusPlan, table.get("stimulus", {}), "stimulus")
    session = build_dataclass(SessionPlan, table.get("session", {}), "session")
    procedure = table.get("procedure", {})
    if not isinstance(procedure, dict):
        raise ValueError(f"procedure is {procedure!r}: expected a table")
    method = procedure.get("method", Plan.method)
    if not isinstance(method, str) or method not in METHODS:
        raise ValueError(f"procedure.method is {method!r}{nearest(str(method), list(METHODS))}")
    options = {key: value for key, value in procedure.items() if key != "method"}
    settings = build_dataclass(METHODS[method], options, "procedure")
    study = build_dataclass(StudyPlan, table.get("study", {}), "study")
    within = build_dataclass(WithinPlan, table.get("within", {}), "within")
    return Plan(name, seed, stimulus, session, method, settings, study, within)


def plan_toml(plan: Plan) -> str:
    """Return a plan as the text of a TOML file."""
    lines: list[str] = []
    tables = []
    for key, value in plan.table().items():
        if isinstance(value, dict):
            tables.append((key, value))
        else:
            lines.append(f"{key} = {_toml(value)}")
    for key, table in tables:
        lines += ["", f"[{key}]", *(f"{name} = {_toml(value)}" for name, value in table.items())]
    return "\n".join(lines) + "\n"


def _plain(settings: Any) -> dict[str, Any]:
    """Convert a dataclass to a table as TOML and JSON return it: tuples are lists."""
    return {key: list(value) if isinstance(value, tuple) else value for key, value in asdict(settings).items()}


def _toml(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        # JSON's escapes are TOML's too, but for one character that JSON leaves as it is.
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, list):
        return "[" + ", ".join(_toml(item) for item in value) + "]"
    return repr(value)


MOVEMENTS = {
    "weight": "Hold your hand with the palm up. Bend your fingers at the knuckles to lift the weight, by up to 4 cm,\n"
    "and let it down again.",
    "stiffness": "Bend your fingers at the knuckles to squeeze the object against your thumb, by up to 1 cm,\n"
    "and open them again.",
    "torque": "Bend your {joint} joint to and fro; something resists it.",
}
OBJECT_NOUNS = {"weight": "weight", "stiffness": "object", "torque": "resistance"}
HINTS = {
    "weight": "Bend your fingers until they lift the weight, let it down, and lift it again.",
    "stiffness": "Bend your fingers until they squeeze the object, open them, and squeeze again.",
    "torque": "Bend your {joint} joint to and fro.",
}


def instructions(plan: Plan) -> str:
    """Return the plan's own instructions, or those for its stimulus, its task and its durations."""
    if plan.session.instructions:
        return plan.session.instructions
    noun = OBJECT_NOUNS[plan.stimulus.kind]
    lines = [f"You wear a glove in which you feel a {noun} that is not there.", "", _movement(plan, MOVEMENTS), ""]
    if plan.method == "matching":
        lines += [
            f"In each trial you feel a first {noun}, and then another one, which you make stronger or weaker until",
            "both feel the same.",
        ]
    else:
        lines += [
            f"In each trial you feel two of them, one after the other{_how_long(plan)}.",
            f"Then say which one was {QUESTIONS[plan.stimulus.kind]}: type 1 or 2, then Enter.",
            "If you cannot tell, guess.",
        ]
        if not plan.session.duration:
            lines.append("Take your time, and move as often as you like.")
    if plan.session.practice:
        lines += ["", f"Practice comes first: trials 1 to {plan.session.practice}."]
    lines += ["", "You may stop at any time, and need not say why."]
    return "\n".join(lines)


def hint(plan: Plan) -> str:
    """Return the hint for a hand that did not move: the plan's own, or that for its stimulus."""
    return plan.session.hint or _movement(plan, HINTS)


def _movement(plan: Plan, texts: dict[str, str]) -> str:
    return texts[plan.stimulus.kind].format(joint=plan.stimulus.joint)


def _how_long(plan: Plan) -> str:
    return f", each for {plan.session.duration:g} s" if plan.session.duration else ""
