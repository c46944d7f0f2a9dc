"""What the reader of an analysis must know of its answers: how many, by whom, how they were felt."""

import numpy as np

from jaxgrasp.psychophysics.plan import Plan
from jaxgrasp.psychophysics.running.recorded_trials import TrialRecord, felt_levels

BRIEF = 0.3
"""Time in which nobody feels a weight [s]."""


def notes_on(plan: Plan, trials: dict[str, list[TrialRecord]], simulated: tuple[str, ...]) -> list[str]:
    """Sentences without a full stop.

    Args:
        plan: of the experiment.
        trials: of each person, without practice.
        simulated: persons who are none.
    """
    notes = [f"{', '.join(simulated)}: answers of a simulated observer"] if simulated else []
    for who, own in trials.items():
        for reference in plan.session.references:
            there = [one for one in own if one["reference"] == reference]
            where = f"{who} at {reference:g} {plan.stimulus.unit}"
            notes += _missing(plan, where, len(there))
            notes += _saturated(where, [one for one in there if one["saturated"]])
        if who not in simulated:
            brief = sum(any(one is not None and one < BRIEF for one in trial["durations"]) for trial in own)
            if brief:
                notes.append(f"{who}: {brief} trials had an interval of less than {BRIEF:g} s, too brief to be felt")
    return notes


def _missing(plan: Plan, where: str, there: int) -> list[str]:
    asked = plan.session.sessions * plan.procedure.most_trials()
    if there == 0:
        return [f"{where}: no trial"]
    if there < asked and plan.method != "staircase":
        return [f"{where}: {there} of {asked} trials"]
    return []


def _saturated(where: str, cut: list[TrialRecord]) -> list[str]:
    """Levels are those that were asked for; what could be felt of them is less."""
    if not cut:
        return []
    note = f"{where}: a torque was cut in {len(cut)} trials"
    felt = felt_levels(cut)
    if felt and "right" in cut[0]:
        asked = np.mean([one["level"] for one in cut])
        note += f", where differences of {asked:.3f} on average were felt as {np.mean(felt):.3f}"
    return [note]
