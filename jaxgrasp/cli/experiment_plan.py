"""``jaxgrasp experiment plan`` and ``power``: what a plan asks, and what it will tell."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np

from jaxgrasp.cli.experiment_arguments import ObserverArguments, PlanCommand, Power
from jaxgrasp.cli.machine import compiling, set_up_jax
from jaxgrasp.cli.terminal import show
from jaxgrasp.files.replace import replace_file
from jaxgrasp.glove.model import GloveModel, load_glove, lrp_hand_master
from jaxgrasp.psychophysics.plan import FIG_8, Plan, instructions, load_plan, parse_within, plan_toml
from jaxgrasp.psychophysics.prediction import cheapest, persons_for_power, within_power
from jaxgrasp.psychophysics.procedures import ConstantStimuli
from jaxgrasp.psychophysics.psychometric import Observer
from jaxgrasp.psychophysics.trial import Rendered, Stimulus
from jaxgrasp.validation.checked import check_not_negative, check_positive

LISTED_DESIGNS = 6
MOST_PERSONS = 100_000
POSTURES = {
    "weight": "lifted by the knuckles, to 4 cm at most",
    "stiffness": "squeezed by the knuckles to 1 cm",
    "torque": "whatever the posture",
}
SELF_PACED = 3.0
"""Time that persons take to feel a stimulus, where the plan leaves it to them [s]."""
ANSWERED = 3.0
"""Time to answer, and until the next trial begins [s]."""
MATCHED = 6
"""Stimuli that are felt until one matches."""
RESTED = 2.0
"""A break [min]."""
STANDARD_ERROR = 0.02
BETWEEN = 0.035
"""Standard deviation of the persons' Weber fractions: what the paper prints at 2 N."""


def plan_command(arguments: PlanCommand) -> int:
    """Read, predict, say."""
    if arguments.write is not None and arguments.write.exists():
        raise ValueError(f"write is {arguments.write}: expected a file that does not exist yet")
    plan = read_plan(arguments.file)
    if arguments.within is not None:
        plan = replace(plan, within=parse_within(arguments.within))
    power = power_of_conditions(plan, arguments)
    if arguments.write is not None:
        replace_file(arguments.write, lambda stream: stream.write(plan_toml(plan).encode()))
        show(f"written: {arguments.write}")
    model = load_glove(arguments.glove) if arguments.glove else lrp_hand_master()
    show("\n".join([*summary(plan), *stimuli(plan), *power]))
    with compiling("the hand and its torques"):
        lines = [*predicted(plan, predicted_stimulus(plan, model)), *beside_the_paper(plan, model)]
    show(f"rendered by {model.name}, {POSTURES[plan.stimulus.kind]}:")
    show("\n".join(lines))
    show("what the person reads first:")
    show("\n".join(f"  | {line}".rstrip() for line in instructions(plan).split("\n")))
    return 0


def power_of_conditions(plan: Plan, arguments: PlanCommand) -> list[str]:
    """Return lines on the conditions and on the power of their comparison; none of a plan without a factor."""
    conditions = plan.within.conditions
    if not conditions:
        return []
    count, numbers = len(conditions), {"correlation": arguments.correlation}
    power = within_power(arguments.effect, arguments.subjects, count, **numbers)
    worst = within_power(arguments.effect, arguments.subjects, count, sphericity=1 / (count - 1), **numbers)
    order = {"balanced": "counterbalanced over persons", "given": "in this order", "random": "in random order"}
    lines = [
        f"{plan.within.factor} within persons: {', '.join(conditions)}, {order[plan.session.order]}",
        f"power of their comparison with {arguments.subjects} persons, for an effect f = {arguments.effect:g} at "
        f"p < 0.05: {power:.2f}, and {worst:.2f} where sphericity fails most",
    ]
    if arguments.effect > 0:
        needed = persons_for_power(arguments.effect, count, 0.8, most=MOST_PERSONS, **numbers)
        lines.append(f"a power of 0.80 takes {needed} persons")
    return lines


def beside_the_paper(plan: Plan, model: GloveModel) -> list[str]:
    """Return a line on the weight that the paper's posture (Fig. 8) bears; no line if the plan has that posture."""
    paper_stimulus = replace(plan.stimulus, fingers=FIG_8, phalanx="distal")
    if plan.stimulus.kind != "weight" or plan.stimulus == paper_stimulus:
        return []
    rendered = predicted_stimulus(replace(plan, stimulus=paper_stimulus), model).predict(1.0)
    largest_weight = min(model.limits) / rendered.torque
    return [
        f"In the paper's Fig. 8 it lies on the distal phalanges of {' and '.join(FIG_8)}, on which {model.name} bears "
        f"{largest_weight:.2f} N"
    ]


def power_command(arguments: Power) -> int:
    """Simulate, and say the designs that take the fewest trials."""
    check_positive(arguments, "wanted", "most_subjects")
    check_not_negative(arguments, "between")
    observer = observer_of(arguments.observer)
    plan = read_plan(arguments.file)
    if not isinstance(plan.procedure, ConstantStimuli):
        raise ValueError(f"procedure.method is {plan.method!r}: expected constant-stimuli, of which power is simulated")
    reference = plan.session.references[0] if arguments.reference is None else arguments.reference
    if reference not in plan.session.references:
        references = ", ".join(f"{level:g}" for level in plan.session.references)
        raise ValueError(f"reference is {reference:g}: expected one of {references}")
    levels = np.array(plan.procedure.levels)
    check_notices(observer, plan)
    standard_error, between = _precision(arguments, plan)
    show(
        f"standard error {standard_error:g} of the mean threshold at {reference:g} {plan.stimulus.unit}, levels "
        f"{', '.join(f'{level:g}' for level in levels)}"
    )
    designs = cheapest(
        standard_error,
        observer,
        reference,
        levels,
        between=between,
        most_subjects=arguments.most_subjects,
    )
    with compiling("the hand and its torques"):
        lines = predicted(plan, predicted_stimulus(plan, lrp_hand_master()))
    for line in warnings(lines):
        show(line)
    if not designs:
        show(f"no design with up to 320 trials a level and {arguments.most_subjects} persons reaches it")
        return 0
    show("trials a level  persons  trials in all  one person's deviation  outside the levels")
    for design in designs[:LISTED_DESIGNS]:
        show(
            f"{design.trials:14d}  {design.subjects:7d}  {design.total(len(levels)):13d}  {design.within:22.4f}  "
            f"{100 * design.outside:17.1f}%"
        )
    return 0


def _precision(arguments: Power, plan: Plan) -> tuple[float, float]:
    """Return wanted standard error and deviation between persons; raise ValueError in detection without them."""
    if plan.is_detection and (arguments.wanted is None or arguments.between is None):
        raise ValueError(f"detection needs --wanted and --between [{plan.stimulus.unit}]")
    standard_error = STANDARD_ERROR if arguments.wanted is None else arguments.wanted
    return standard_error, BETWEEN if arguments.between is None else arguments.between


def check_notices(observer: Observer, plan: Plan) -> None:
    """Raise ValueError for an observer who notices anything at all in a plan of detection."""
    if plan.is_detection and not observer.absolute > 0:
        raise ValueError(f"absolute is {observer.absolute}: expected the observer's threshold [{plan.stimulus.unit}]")


def read_plan(path: Path | None) -> Plan:
    """Load the plan of a file, or return the paper's plan where ``path`` is None."""
    return Plan() if path is None else load_plan(path)


def observer_of(arguments: ObserverArguments) -> Observer:
    """Return the simulated observer of the arguments."""
    parts = (arguments.weber, arguments.absolute, arguments.lapse, arguments.bias, arguments.learning)
    return Observer(*parts)


def predicted_stimulus(plan: Plan, model: GloveModel) -> Stimulus:
    """Return the plan's stimulus as the glove can render it, to predict torques and saturation."""
    set_up_jax("float64")
    from jaxgrasp.lab.felt_objects import felt_object
    from jaxgrasp.lab.simulated_weight import rendering_of
    from jaxgrasp.lab.stimuli import PredictedGloveStimulus

    object_ = felt_object(plan.stimulus, model)
    return PredictedGloveStimulus(object_, model, rendering_of(plan.stimulus, object_, model))


def summary(plan: Plan) -> list[str]:
    """Format sessions, trials and duration of a plan as lines, without intensities, which the person must not know."""
    return [
        f"{plan.name}: {plan.method}, {plan.session.sessions} session(s) each",
        f"trials of a person: {plan.at_most()}, {plan.session.practice} of them practice; "
        f"a break every {plan.session.break_every}; {_lasts(plan)}",
    ]


def _lasts(plan: Plan) -> str:
    """Estimate the time for one person, from the plan's durations or else from typical ones, in words."""
    session = plan.session
    stimulus_s = session.duration or SELF_PACED
    intervals = MATCHED * stimulus_s if plan.method == "matching" else 2 * stimulus_s + session.pause
    minutes = plan.most_trials() * (intervals + ANSWERED) / 60
    rests = max(0, (plan.most_trials() - session.practice - 1) // session.break_every)
    return f"{max(1.0, minutes + rests * RESTED):.0f} min or so, with {stimulus_s:g} s for each stimulus"


def stimuli(plan: Plan) -> list[str]:
    """Format the kind of stimulus, its place on the hand and its references as a line."""
    unit = plan.stimulus.unit
    location = plan.stimulus.joint if plan.stimulus.kind == "torque" else " and ".join(plan.stimulus.fingers)
    if plan.stimulus.kind == "weight":
        location = f"the {plan.stimulus.phalanx} phalanges of {location}"
    references = ", ".join(f"{reference:g}" for reference in plan.session.references)
    return [
        f"{plan.stimulus.kind} on {location}, {'detection' if plan.is_detection else f'references {references} {unit}'}"
    ]


def warnings(lines: list[str]) -> list[str]:
    """Return the warnings among the lines of [`predicted`][jaxgrasp.cli.experiment_plan.predicted]."""
    return [line for line in lines if line.startswith("WARNING")]


def predicted(plan: Plan, stimulus: Stimulus) -> list[str]:
    """Format a line for each intensity of the plan, and a warning on those that the glove cannot render."""
    renderings = [stimulus.predict(intensity) for intensity in plan.intensities() if intensity > 0]
    lines = [_line(rendering, plan.stimulus.unit) for rendering in renderings]
    cut = [rendering for rendering in renderings if rendering.saturated]
    if cut:
        lines.append(
            f"WARNING: {len(cut)} of {len(renderings)} stimuli need more torque than the glove has, from "
            f"{cut[0].intensity:g} {plan.stimulus.unit} on: their trials will be flagged, and left out of the analysis"
        )
    return lines


def _line(rendering: Rendered, unit: str) -> str:
    words = f"SATURATES, feels like {rendering.felt_intensity:.3g} {unit}" if rendering.saturated else "rendered whole"
    warm = (
        f", for {rendering.max_duration_s:.0f} s until motors are warm"
        if math.isfinite(rendering.max_duration_s)
        else ""
    )
    return f"  {rendering.intensity:8.4g} {unit}: torques up to {rendering.torque:.4f} N\N{MIDDLE DOT}m, {words}{warm}"
