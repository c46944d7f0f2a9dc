"""Notes on answers for the reader of an analysis: missing, simulated, saturated and brief trials."""

import numpy as np

from jaxgrasp.psychophysics.plan import Plan
from jaxgrasp.psychophysics.running.recorded_trials import TrialRecord, felt_levels

BRIEF = 0.3
"""Time in which nobody feels a weight [s]."""


def notes_on(plan: Plan, trials: dict[str, list[TrialRecord]], simulated: tuple[str, ...]) -> list[str]:
    """Return notes on the answers, as sentences without a full stop.

    Args:
        plan: of the experiment.
        trials: of each person, without practice.
        simulated: codes of simulated observers among the persons.
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
    """Return a note on the trials in which a torque was cut, with the differences asked for and felt, if any."""
    if not cut:
        return []
    note = f"{where}: a torque was cut in {len(cut)} trials"
    felt = felt_levels(cut)
    if felt and "right" in cut[0]:
        asked = np.mean([one["level"] for one in cut])
        note += f", where differences of {asked:.3f} on average were felt as {np.mean(felt):.3f}"
    return [note]
