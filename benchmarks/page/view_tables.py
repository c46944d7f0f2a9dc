"""The live scene's page in Markdown, from the report that the JSON holds too."""

from collections.abc import Callable
from typing import Any

from benchmarks.page.tables import NOTHING, table

WAYS = {
    "seen": "posture to contacts, forces by both laws, verdicts and torques",
    "sent": "slider to what is sent to the browser: all that, the drawing and the words",
    "drawn": "slider to the frame that Chromium has drawn, without a graphics card",
}


def page(report: dict) -> str:
    facts = report["machine"]
    parts = [
        "# The live scene",
        f"Made by `python -m benchmarks.view`. {facts['processor']}, {facts['cores']} cores, {facts['system']}, "
        f"Python {facts['python']}.",
    ]
    sections: dict[str, Callable[[Any], str]] = {"frames": _frames, "beside": _beside, "steps": _steps}
    parts += [write(report[name]) for name, write in sections.items() if name in report]
    return "\n\n".join(parts) + "\n"


def _frames(row: dict) -> str:
    rows = [
        [WAYS[name], f"{statistics['median']:.1f}", f"{statistics['p99']:.1f}", _optional(statistics.get("processors"))]
        for name, statistics in row["milliseconds"].items()
    ]
    return (
        f"## From a posture to a picture\n\nA hand of {row['links']} links with {row['contacts']} contacts; "
        f"milliseconds, while {row['load']:.0f} processes wanted the processors (the load average). Asked: 50 to a "
        f"drawn frame. The first posture takes {row['compiling_s']:.0f} s where the "
        f"compiled code is kept. The page in a file is {row['saved_megabytes']:.1f} MB; asked: 5.\n\n"
        + table(["way", "median", "99 of 100", "of the processors, median"], rows)
    )


def _beside(row: dict) -> str:
    rows = [
        [name, f"{loop['ticks']:.0f}", f"{loop['milliseconds']['median']:.1f}", f"{loop['milliseconds']['p99']:.1f}"]
        for name, loop in (("alone", row["alone"]), ("beside the page", row["followed"]))
    ]
    return (
        f"## Beside a haptic loop\n\nA hand of {row['links']} links with {row['contacts']} contacts, a loop of 100 "
        f"ticks a second in one process (its niceness {row['niceness']}) and the page in another; the load average "
        f"was {row['load']:.0f}. {row['frames']:.0f} frames a second come to a client that reads all and draws "
        f"nothing; asked: 30. A frame takes the page {row['frame_ms']:.0f} ms of a processor.\n\n"
        + table(["loop", "ticks a second", "median ms of a tick", "99 of 100"], rows)
    )


def _steps(row: dict) -> str:
    rows = [
        [k + 1, f"{held:.0f}", messages]
        for k, (held, messages) in enumerate(zip(row["megabytes"], row["messages"], strict=True))
    ]
    return (
        f"## Grasps of a file\n\n{row['grasps']:,} grasps are stepped through three times, "
        f"{row['milliseconds']:.1f} ms each in the median; what the process holds after each time, and messages that "
        "are kept for the next browser.\n\n" + table(["time", "MB", "messages"], rows)
    )


def _optional(value: float | None) -> str:
    return NOTHING if value is None else f"{value:.1f}"
