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
    for subject, subject_trials in trials.items():
        for reference in plan.session.references:
            at_reference = [trial for trial in subject_trials if trial["reference"] == reference]
            label = f"{subject} at {reference:g} {plan.stimulus.unit}"
            notes += _missing(plan, label, len(at_reference))
            notes += _saturated(label, [trial for trial in at_reference if trial["saturated"]])
        if subject not in simulated:
            brief = sum(
                any(duration is not None and duration < BRIEF for duration in trial["durations"])
                for trial in subject_trials
            )
            if brief:
                notes.append(
                    f"{subject}: {brief} trials had an interval of less than {BRIEF:g} s, too brief to be felt"
                )
    return notes


def _missing(plan: Plan, label: str, n_trials: int) -> list[str]:
    n_planned = plan.session.sessions * plan.procedure.most_trials()
    if n_trials == 0:
        return [f"{label}: no trial"]
    if n_trials < n_planned and plan.method != "staircase":
        return [f"{label}: {n_trials} of {n_planned} trials"]
    return []


def _saturated(label: str, cut: list[TrialRecord]) -> list[str]:
    """Return a note on the trials in which a torque was cut, with the differences asked for and felt, if any."""
    if not cut:
        return []
    note = f"{label}: a torque was cut in {len(cut)} trials"
    felt_differences = felt_levels(cut)
    if felt_differences and "right" in cut[0]:
        mean_level = np.mean([trial["level"] for trial in cut])
        note += f", where differences of {mean_level:.3f} on average were felt as {np.mean(felt_differences):.3f}"
    return [note]
