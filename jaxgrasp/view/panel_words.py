"""Text of a page's panel as HTML: hold of the object, both verdicts and their advice, contacts, and torques.

Beside a haptic loop also what the person in a glove feels: torques asked for and given, why there are none, and the
picture's age.
"""

import math
import time
from collections.abc import Iterable
from typing import Any

import numpy as np

from jaxgrasp.glove.glove_device import LinkState
from jaxgrasp.glove.guard import GuardState
from jaxgrasp.grip.monitor import Hold, Touch
from jaxgrasp.model.solution import Solution, Verdict, is_balanced
from jaxgrasp.report.grip_over_time import Scale
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
from jaxgrasp.view.drawing import SolvedGrasp
from jaxgrasp.view.view_slots import ViewFrame

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


STALE_AGE = 0.3
"""Age of what is shown from which on it counts as old [s]."""
ALARM = "#B3261E"
FULL_BAR = 0.12
"""Torque for which a bar is full, where none is larger [N.m]: that of the paper's glove."""
NO_TORQUE = "No torque is felt: 0 N\N{MIDDLE DOT}m"
ARM = "type arm at the terminal of the glove's host"
AT_EXPERIMENT = "the experimenter arms it at the terminal"


def is_felt(frame: ViewFrame) -> bool:
    """Return whether torque may flow in a frame: the glove and its host say that they are armed."""
    return frame.link == LinkState.ARMED and frame.guard == GuardState.ARMED


def felt_nothing_reason(frame: ViewFrame) -> str:
    """Return why no torque is felt in a frame; empty where torque may flow."""
    if is_felt(frame):
        return ""
    if frame.angles_at <= 0 and frame.link < LinkState.LINKED:
        return frame.cause or "no glove has answered yet"
    if frame.link < LinkState.LINKED:
        return f"the glove is gone: {frame.cause}" if frame.cause else "the glove is gone"
    if frame.guard == GuardState.LATCHED:
        return frame.cause or "the glove let go"
    return "the glove is being armed" if frame.link == LinkState.ARMING else "the glove is not armed"


def remedy(frame: ViewFrame, arm: str = ARM) -> str:
    """Return what to do so that torque flows again."""
    if frame.link < LinkState.LINKED:
        return f"connect it, or switch it on; then {arm}"
    return "" if frame.link == LinkState.ARMING else arm


def notice_html(frame: ViewFrame, arm: str = ARM, *, tells_reason: bool = True) -> str:
    """Return a large notice of zero felt torque, its reason and what to do; empty where torque may flow.

    Args:
        frame: that is shown.
        arm: how the glove is armed.
        tells_reason: False for the subject of an experiment: the torques in a reason would tell the stimulus.
    """
    reason = felt_nothing_reason(frame)
    if not reason:
        return ""
    return _alarm("none", NO_TORQUE, [reason if tells_reason else "", remedy(frame, arm)])


def stale_html(source: str, age_s: float, since: float, is_page_slow: bool = False) -> str:
    """Return a notice that the picture is old.

    Args:
        source: sentence on what sends nothing new.
        age_s: age of what is shown [s].
        since: time of day from which on nothing new came [s since the epoch].
        is_page_slow: True if engine and glove go on, and only this page does not.
    """
    clock = time.strftime("%H:%M:%S", time.localtime(since))
    lines = [f"{source} since {clock}"]
    if not is_page_slow:
        lines.append(f"a glove without fresh torques lets go. {NO_TORQUE}")
    return _alarm("stale", f"Old picture: {age_s:.1f} s", lines)


def _alarm(kind: str, title: str, lines: Iterable[str]) -> str:
    below = "".join(f"<div>{text(line)}</div>" for line in lines if line)
    return (
        f'<div data-felt="{kind}" style="{FONT};background:{ALARM};color:white;padding:10px 12px;border-radius:8px;'
        f'margin:6px 8px"><div style="font-size:24px;font-weight:700;line-height:1.2">{title}</div>{below}</div>'
    )


def felt_torques_html(joints: Iterable[str], frame: ViewFrame) -> str:
    """Return a table of a glove's joints: torque asked for, given and measured [N.m], and for how long it was cut."""
    joints = list(joints)
    finite = np.nan_to_num(np.stack([frame.torques, frame.given]))
    largest = max(float(np.abs(finite).max(initial=0)), FULL_BAR)
    colours = finger_colours(name.split()[0] for name in joints)
    rows = "".join(
        _felt_row(name, colours[name.split()[0]], largest, *(float(x[k]) for x in _columns(frame)))
        for k, name in enumerate(joints)
    )
    head = "".join(
        f'<th style="text-align:right;font-weight:600;padding-left:6px">{title}</th>'
        for title in ("asked", "given", "measured", "cut [s]")
    )
    return (
        f'<div style="{FONT};color:{INK};padding:4px 10px 8px"><div style="color:{MUTED};margin-bottom:4px">torques '
        f"against flexion [N\N{MIDDLE DOT}m]: outlined, what the law asks; full, what the glove gives; a full bar is "
        f'{number(largest)}</div><table data-torques style="width:100%;border-collapse:collapse;font-size:11.5px;'
        f'white-space:nowrap;font-variant-numeric:tabular-nums"><tr><th></th><th style="width:30%"></th>{head}</tr>'
        f"{rows}</table></div>"
    )


def _columns(frame: ViewFrame) -> tuple[np.ndarray, ...]:
    return frame.torques, frame.given, frame.measured, frame.cut_s


def _felt_row(name: str, colour: str, largest: float, asked: float, given: float, measured: float, cut_s: float) -> str:
    is_cut = math.isfinite(cut_s) and cut_s > 0
    cells = "".join(
        f'<td style="text-align:right;padding-left:6px;color:{tint}">{value}</td>'
        for value, tint in (
            (_torque(asked), INK),
            (_torque(given), INK),
            (_torque(measured), MUTED),
            (f"{cut_s:.1f}" if is_cut else "", ALARM),
        )
    )
    widths = [100 * min(max(torque / largest, 0.0), 1.0) if math.isfinite(torque) else 0.0 for torque in (asked, given)]
    return (
        f'<tr data-joint="{text(name)}"><td style="text-align:right;padding-right:6px">{text(name)}</td>'
        f'<td><span style="display:block;position:relative;height:9px;background:{GRID};border-radius:3px">'
        f'<span style="position:absolute;left:0;width:{widths[1]:.1f}%;height:9px;background:{colour};'
        f'border-radius:3px"></span><span style="position:absolute;left:0;width:{widths[0]:.1f}%;height:9px;'
        f'box-sizing:border-box;border:1px solid {colour};border-radius:3px"></span></span></td>{cells}</tr>'
    )


def _torque(torque: float) -> str:
    if not math.isfinite(torque):
        return "\N{EN DASH}"
    return f"{torque:z.3f}".replace("-", "\N{MINUS SIGN}")


def heartbeat_html(since: float) -> str:
    """Return a part of the page that covers it by itself, unless the next one replaces it within ``STALE_AGE``.

    The browser alone times it, so it shows what no page can say of itself: its process hangs, or is out of reach.

    Args:
        since: time of day of what is shown [s since the epoch]; it makes each part another one.
    """
    clock = time.strftime("%H:%M:%S", time.localtime(since))
    return (
        "<style>@keyframes jaxgrasp-old{to{visibility:visible}}</style>"
        f'<div data-heartbeat="{since:.2f}" style="{FONT};position:fixed;inset:0;z-index:9999;pointer-events:none;'
        "background:#8a8a8ab0;visibility:hidden;display:flex;align-items:center;justify-content:center;"
        f'animation:jaxgrasp-old 1ms linear {STALE_AGE:g}s forwards"><div style="background:{ALARM};color:white;'
        'padding:14px 18px;border-radius:8px;text-align:center"><div style="font-size:24px;font-weight:700">Old picture'
        f"</div><div>nothing new has come since {clock}</div></div></div>"
    )


HEARTBEAT_PERIOD = 0.1
"""Time between two updates of the part that covers an old page [s]."""
AGE_PERIOD = 0.2
"""Time between two updates of the age of an old picture [s]."""


class FeltNotice:
    """Notices at the top of a page: none where torque flows and the picture is fresh."""

    def __init__(self, server: Any, arm: str = ARM, *, tells_reason: bool = True) -> None:
        """Add the notices to a server's panel; arguments as of [`notice_html`][]."""
        self._part, self._heartbeat = server.gui.add_html(""), server.gui.add_html("")
        self._arm, self._tells_reason = arm, tells_reason
        self._beat_at = self._updated_at = -math.inf
        self.is_stale = False
        """True if what is shown is older than ``STALE_AGE``; False before the first frame of a glove."""

    @property
    def html(self) -> str:
        """Return the notices; empty where there are none."""
        return str(self._part.content)

    def update(self, shown: ViewFrame, newest: ViewFrame) -> None:
        """Update the notices.

        Args:
            shown: frame that the page shows.
            newest: latest frame of the engine.
        """
        timestamp = time.perf_counter()
        stale, was_stale = stale_notice(timestamp, shown, newest), self.is_stale
        self.is_stale = bool(stale)
        if self.is_stale and was_stale and timestamp - self._updated_at < AGE_PERIOD:
            return
        self._updated_at = timestamp
        html = stale + notice_html(newest, self._arm, tells_reason=self._tells_reason)
        if html != self._part.content:
            self._part.content = html
        if self.is_stale or not shown.angles_at > 0:
            self._heartbeat.content = ""
        elif timestamp - self._beat_at >= HEARTBEAT_PERIOD:
            self._beat_at = timestamp
            self._heartbeat.content = heartbeat_html(time.time())


def stale_notice(timestamp: float, shown: ViewFrame, newest: ViewFrame) -> str:
    """Return the notice of an old picture at a time [s], on the clock of the frames; empty for a fresh one.

    Args:
        timestamp: the time.
        shown: frame that the page shows.
        newest: latest frame of the engine; a fresh one is that of a page that does not keep up.
    """
    if not shown.angles_at > 0:
        return ""
    for source, at in (
        ("the engine has computed nothing", newest.ticked_at),
        ("the glove has sent no angles", newest.angles_at),
        ("this page does not keep up with the engine: it has shown nothing new", shown.angles_at),
    ):
        age_s = timestamp - at
        if age_s > STALE_AGE:
            is_page_slow = max(timestamp - newest.ticked_at, timestamp - newest.angles_at) <= STALE_AGE
            return stale_html(source, age_s, time.time() - age_s, is_page_slow)
    return ""
