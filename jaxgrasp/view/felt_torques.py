"""Text of what the person in a glove feels: torques asked for and given, why there are none, and the picture's age."""

import math
import time
from collections.abc import Iterable
from typing import Any

import numpy as np

from jaxgrasp.glove.glove_device import LinkState
from jaxgrasp.glove.guard import GuardState
from jaxgrasp.report.look import GRID, INK, MUTED, finger_colours, number, text
from jaxgrasp.view.view_slots import ViewFrame

STALE_AGE = 0.3
"""Age of what is shown from which on it counts as old [s]."""
ALARM = "#B3261E"
FULL_BAR = 0.12
"""Torque for which a bar is full, where none is larger [N.m]: that of the paper's glove."""
FONT = "font: 13px/1.4 system-ui, sans-serif"
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
        _row(name, colours[name.split()[0]], largest, *(float(x[k]) for x in _columns(frame)))
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


def _row(name: str, colour: str, largest: float, asked: float, given: float, measured: float, cut_s: float) -> str:
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
