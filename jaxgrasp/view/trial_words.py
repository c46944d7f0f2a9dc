"""Text on the pages of an experiment: the subject's question and the experimenter's details."""

import math
from enum import IntEnum

from jaxgrasp.psychophysics.plan import QUESTIONS, UNITS
from jaxgrasp.report.look import INK, MUTED, number
from jaxgrasp.view.view_slots import TrialNow


class Phase(IntEnum):
    """Current activity of a person in an experiment."""

    WAITS = 0
    FEELS = 1
    CHOOSES = 2
    ADJUSTS = 3
    RESTS = 4


def subject_html(now: TrialNow, kind: str) -> str:
    """Return the subject's instruction or question, without any hint at the right answer."""
    match Phase(int(now.phase)):
        case Phase.FEELS:
            asked = f"Feel the {_felt(now)} one."
        case Phase.CHOOSES:
            asked = f"Which one was {QUESTIONS[kind]}, 1 or 2?"
        case Phase.ADJUSTS:
            asked = "Make it feel the same: + or \N{MINUS SIGN}."
        case Phase.RESTS:
            asked = "Rest."
        case _:
            asked = "It is about to begin."
    trial = f"trial {now.number:.0f} of {now.most:.0f} at most" if math.isfinite(now.number) else ""
    return (
        f'<div data-asked style="font: 600 22px/1.35 system-ui, sans-serif;color:{INK};padding:12px">{asked}</div>'
        f'<div style="font: 14px/1.4 system-ui, sans-serif;color:{MUTED};padding:0 12px 12px">{trial}</div>'
    )


def _felt(now: TrialNow) -> str:
    """Return the name of the stimulus that the person feels: reference, first or second."""
    return "reference" if math.isfinite(now.setting) else "first" if now.interval == 1 else "second"


def experimenter_html(now: TrialNow, kind: str) -> str:
    """Return all details of a trial: rendered stimuli, the right answer, and the number of right answers."""
    phase = Phase(int(now.phase))
    rows = [("just now", f"feels the {_felt(now)}" if phase == Phase.FEELS else phase.name.lower())]
    if math.isfinite(now.number):
        rows.append(("trial", f"{now.number:.0f} of {now.most:.0f} at most"))
        rows.append(("first", f"{number(now.first)} {UNITS[kind]}"))
        rows.append(("second", f"{number(now.second)} {UNITS[kind]}"))
        if math.isfinite(now.setting):
            rows.append(("set to", f"{number(now.setting)} {UNITS[kind]}"))
        else:
            rows.append((QUESTIONS[kind], "the first" if now.first > now.second else "the second"))
    if now.answered:
        rows.append(("right so far", f"{now.right:.0f} of {now.answered:.0f}"))
    cells = "".join(f'<tr><td style="color:{MUTED};padding-right:12px">{a}</td><td>{b}</td></tr>' for a, b in rows)
    return f'<table data-trial style="font: 13px/1.5 system-ui, sans-serif;color:{INK};margin:6px 12px">{cells}</table>'
