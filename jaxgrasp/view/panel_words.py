"""Text of the panel as HTML: hold of the object, both verdicts and their advice, contacts, and torques."""

import math
from collections.abc import Iterable

import numpy as np

from jaxgrasp.grip.monitor import Hold, Touch
from jaxgrasp.model.solution import Solution, Verdict, is_balanced
from jaxgrasp.report.look import (
    GRID,
    HOLD_COLOURS,
    INK,
    METHOD_COLOURS,
    MUTED,
    TOUCH_COLOURS,
    VERDICT_COLOURS,
    VERDICT_TITLES,
    finger_colours,
    method_title,
    number,
    text,
)
from jaxgrasp.report.stage import Scale
from jaxgrasp.view.solved_grasp import SolvedGrasp

SAYS = {Touch.HOLDS: "holds", Touch.SLIDES: "slides", Touch.PULLS: "pulls"}
HEADLINES = {Hold.STABLE: "It holds", Hold.SLIPPING: "It slips", Hold.LOST: "Nothing touches it"}
LEAST_BAR = 0.05
"""Torque for which a bar is full, where no joint bears more [N.m]."""
FONT = "font: 13px/1.4 system-ui, sans-serif"


def headline(solved: SolvedGrasp) -> str:
    """Return a short statement of the object's hold under the law that the hand applies."""
    hold = Hold(int(solved.assessment.hold))
    if solved.rests:
        return "It stands on the table"
    if hold == Hold.SLIPPING and solved.escape is not None:
        return "It escapes: no forces hold it"
    if hold == Hold.SLIPPING and bool(solved.assessment.disagrees):
        return "It slips, though other forces would hold it"
    if hold == Hold.STABLE and bool(solved.assessment.disagrees):
        return "It holds, though the closed form slips"
    return HEADLINES[hold]


def words_html(solved: SolvedGrasp, scale: Scale) -> str:
    """Return verdict, margins and advice of both laws, and the scale of the arrows."""
    hold = Hold(int(solved.assessment.hold))
    colour = MUTED if solved.rests else HOLD_COLOURS[hold]
    parts = [
        f'<div data-hold="{hold.name}" style="font-weight:650;font-size:17px;padding:7px 11px;border-radius:8px;'
        f'background:{colour};color:white;margin-bottom:8px">{headline(solved)}</div>',
        *(_answer(solved, name, answer, margins) for name, answer, margins in solved.answers()),
        f'<div style="color:{MUTED};margin-top:6px">Arrows: {number(1000 * scale.length)} mm stand for '
        f"{number(scale.newtons)} N. Black: the load, {number(_newtons(solved))} N.</div>",
    ]
    return _block("".join(parts))


def torques_html(solved: SolvedGrasp) -> str:
    """Return bars of the joints' torques, to the left against flexion; empty without a hand."""
    if solved.hand is None:
        return ""
    return bars_html(solved.hand.joints, solved.hand.torques)


def bars_html(joints: Iterable[str], torques: np.ndarray) -> str:
    """Return a bar of the torque [N.m] of each joint, in its finger's colour."""
    joints = list(joints)
    largest = max(float(np.abs(np.nan_to_num(torques)).max(initial=0)), LEAST_BAR)
    colours = finger_colours(name.split()[0] for name in joints)
    rows = [
        _row(name, largest, float(torque), colours[name.split()[0]])
        for name, torque in zip(joints, torques, strict=True)
    ]
    head = (
        f'<div style="color:{MUTED};margin-bottom:4px">torques of the joints [N·m], against flexion to the left; '
        f"a full half is {number(largest)}</div>"
    )
    return _block(head + "".join(rows))


def _answer(solved: SolvedGrasp, name: str, answer: Solution, margins: np.ndarray) -> str:
    verdict = Verdict(int(answer.verdict))
    applied = (name == "B") == (solved.law == "closed-form")
    sizes = ""
    if is_balanced(verdict) and solved.touching.any():
        forces = np.linalg.norm(solved.forces(answer), axis=1)
        worst = int(np.argmin(np.where(solved.touching, margins, np.inf)))
        margin = float(margins[worst])
        sizes = f"largest force {number(float(forces.max()))} N"
        if math.isfinite(margin):
            sizes += f", smallest friction margin {_margin(margin)} ({text(solved.names[worst])})"
    mark = f'<span style="color:{MUTED};font-weight:400"> (applied)</span>' if applied else ""
    return (
        f'<div style="border-left:4px solid {METHOD_COLOURS[name]};padding:1px 0 1px 9px;margin:7px 0">'
        f'<div style="font-weight:600">{method_title(name)}{mark}: '
        f'<span data-verdict="{name}" style="border-bottom:2px solid {VERDICT_COLOURS[verdict]}">'
        f"{VERDICT_TITLES[verdict]}</span></div><div>{sizes}</div>"
        f'<div style="color:{MUTED}">{text(answer.advice)}</div></div>'
    )


def contacts_html(solved: SolvedGrasp) -> str:
    """Return a table of the contacts that touch: state, and by both laws force and friction margin."""
    touching = np.flatnonzero(solved.touching)
    if not len(touching):
        return ""
    forces, touches = [(solved.forces(answer), margins) for _, answer, margins in solved.answers()], solved.touches
    rows = []
    for i in touching.tolist():
        touch = Touch(int(touches[i]))
        cells = "".join(
            f'<td style="text-align:right;padding-left:9px">{_force(force[i], float(margins[i]))}</td>'
            for force, margins in forces
        )
        dot = f'<span style="color:{TOUCH_COLOURS.get(touch, MUTED)}">\N{BLACK CIRCLE}</span>'
        rows.append(f"<tr><td>{dot} {text(solved.names[i])}</td><td>{SAYS.get(touch, '')}</td>{cells}</tr>")
    head = "".join(
        f'<th style="text-align:right;padding-left:9px;color:{METHOD_COLOURS[name]};font-weight:600">{title}</th>'
        for name, title in (("B", "closed form"), ("B-optimum", "optimum"))
    )
    top = f'<tr><th style="text-align:left;font-weight:600">contact</th><th></th>{head}</tr>'
    return _block(
        '<table style="width:100%;border-collapse:collapse;font-size:12px;white-space:nowrap;'
        'font-variant-numeric:tabular-nums">'
        f"{top}{''.join(rows)}</table>"
    )


def _force(force: np.ndarray, margin: float) -> str:
    size = float(np.linalg.norm(force))
    if size == 0:
        return "\N{EN DASH}"
    return f"{number(size, 2)} N, {_margin(margin)}" if math.isfinite(margin) else f"{number(size, 2)} N"


def _margin(margin: float) -> str:
    """Format a friction margin [rad] to 0.1 degrees; rounding errors on the cone's surface become zero."""
    tenths = round(math.degrees(margin), 1) + 0.0
    return f"{tenths:.1f}°".replace("-", "\N{MINUS SIGN}")


def _newtons(solved: SolvedGrasp) -> float:
    return float(np.linalg.norm(solved.wrench[:3]))


def _row(name: str, largest: float, torque: float, colour: str) -> str:
    """Return a row with a joint's name, a bar for its torque [N.m] in its colour, and the number."""
    return (
        '<div style="display:flex;align-items:center;gap:7px;height:16px;font-size:11.5px">'
        f'<span style="width:7.5em;text-align:right;white-space:nowrap">{text(name)}</span>'
        f'<span style="flex:1">{_bar(torque, largest, colour, 9)}</span>'
        f'<span style="width:3.6em;font-variant-numeric:tabular-nums;color:{INK}">{_signed(torque)}</span></div>'
    )


def _bar(torque: float, largest: float, colour: str, height: int) -> str:
    share = min(max(torque / largest, -1.0), 1.0)
    width, left = 50 * abs(share), 50 if share >= 0 else 50 - 50 * abs(share)
    return (
        f'<span style="display:block;position:relative;height:{height}px;background:{GRID};border-radius:3px">'
        f'<span style="position:absolute;left:{left:.1f}%;width:{width:.1f}%;height:{height}px;background:{colour};'
        f'border-radius:3px"></span>'
        f'<span style="position:absolute;left:50%;width:1px;height:{height}px;background:{INK}"></span></span>'
    )


def _signed(torque: float) -> str:
    return f"{torque:.3f}".replace("-", "\N{MINUS SIGN}")


def _block(content: str) -> str:
    return f'<div style="{FONT};color:{INK};padding:4px 10px 8px">{content}</div>'
