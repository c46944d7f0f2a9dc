"""The glove's page in Markdown, from the report that the JSON holds too."""

from collections.abc import Callable
from typing import Any

import numpy as np

from benchmarks.page.tables import table


def page(report: dict) -> str:
    facts = report["machine"]
    parts = [
        "# The glove's promises",
        f"Made by `python -m benchmarks.glove`. {facts['processor']}, {facts['system']}, Python {facts['python']}. "
        "The line is a pseudo-terminal that lets bytes through at 115,200 baud.",
    ]
    sections: dict[str, Callable[[Any], str]] = {
        "frames": _frames,
        "rubbish": _rubbish,
        "zero_times": _zero_times,
        "drifting_faults": _drifting_faults,
        "relinks": _relinks,
        "ticks": _ticks,
        "towers": _towers,
        "long_run": _long_run,
    }
    parts += [write(report[name]) for name, write in sections.items() if name in report]
    return "\n\n".join(parts) + "\n"


def _frames(row: dict) -> str:
    refused = ", ".join(f"{count:,} {reason.lower()}" for reason, count in row["refused"].items() if count)
    sums = "adds up" if row["adds_up"] else "DOES NOT ADD UP"
    return (
        "## A bad line\n\n"
        f"{row['sent']:,} frames, {row['faults']:,} of them spoilt (a bit, a lost byte, bytes from nowhere, a "
        f"burst, a prefix, the whole frame): {row['wrong']} wrong ones accepted; accepted {row['accepted']:,} + "
        f"missing {row['missing']:,} = sent, which {sums}. Good frames lost beside the spoilt: "
        f"{max(row['lost_of_good'], 0):,}, at most one a fault. Refused, by why: {refused}."
    )


def _rubbish(rows: list[dict]) -> str:
    return "## Random bytes\n\nNo decoder raised.\n\n" + table(
        ["decoder", "bytes", "most kept"],
        [[row["decoder"], f"{row['bytes']:,}", row["most_kept"]] for row in rows],
    )


def _zero_times(rows: list[dict]) -> str:
    text = (
        "## Torque after a failure\n\n"
        "Milliseconds for which the simulated device still held torque, by its own clock, under the native protocol at "
        "115,200 baud. Asked: 55.\n\n"
    )
    return text + _times("failure", [(row["way"], row["milliseconds"]) for row in rows])


def _drifting_faults(rows: list[dict]) -> str:
    text = (
        "## Torque after a fault while delays drift\n\n"
        "In virtual time, the host against a device that is written from the protocol's page alone and shares no code "
        "with it (`tests/glove/independent_rig.py`). The delay grows by 10 ms/s, out, back, or both ways together, up "
        "to 10 ms; the device's clock is off by up to half a per cent. Milliseconds for which it still held torque. "
        "Asked: 55.\n\n"
    )
    return text + _times("fault", [(row["fault"], row["milliseconds"]) for row in rows])


def _times(title: str, rows: list[tuple[str, list[float]]]) -> str:
    lines = [[name, len(times), f"{np.median(times):.0f}", f"{max(times):.0f}"] for name, times in rows]
    return table([title, "trials", "median", "largest"], lines)


def _relinks(row: dict) -> str:
    spent = row["milliseconds"]
    state = "latched until armed" if row["latched"] else "NOT LATCHED"
    return (
        f"## Back on line\n\nLinked again {np.median(spent):.0f} ms after the port came back (median of {len(spent)}; "
        f"largest {max(spent):.0f}), {state}. Asked: 2,000."
    )


def _ticks(row: dict) -> str:
    heads = ["scene", "objects", "law", "kernel", "contacts", "median", "99 %", "first [s]"]
    lines = [
        [
            tick["scene"],
            tick["objects"],
            tick["law"],
            "yes" if tick["kernel"] else "no",
            tick["contacts"],
            f"{tick['median']:.2f}",
            f"{tick['p99']:.2f}",
            f"{tick['first']:.0f}",
        ]
        for tick in row["rows"]
    ]
    return (
        "## A tick\n\nOf the haptic loop, from 14 joint angles through the objects' motion, contacts and forces to 14 "
        "torques and their derivative, while the fingers move and the hand lifts: milliseconds of the processor. The "
        f"first one compiles. The line takes {row['line']:.2f} ms for a frame.\n\n{table(heads, lines)}"
    )


def _towers(rows: list[dict]) -> str:
    heads = ["engine", "blocks", "median", "first [s]", "moved in the end [um]"]
    lines = [
        [row["engine"], row["blocks"], f"{row['median']:.1f}", f"{row['first']:.1f}", f"{1e6 * row['moved']:.1f}"]
        for row in rows
    ]
    return (
        "## Objects on one another\n\nSteps of 10 ms of the engines of several objects, for towers of blocks at rest: "
        f"milliseconds of the processor. The first step compiles.\n\n{table(heads, lines)}"
    )


def _long_run(row: dict) -> str:
    summary, device = row["summary"], row["device"]
    grown = row["grown_megabytes"]
    turns = summary["turns"]
    lost = row["device_frames"]["missing"]
    return (
        f"## {row['minutes']:g} minutes at 200 Hz\n\n"
        f"{turns:,} turns, {summary['overruns']:,} of them overrun ({100 * summary['overruns'] / turns:.2f} %), the "
        f"latest {summary['worst']:.1f} ms late. Memory grew by {grown['host']:.2f} MB (I/O process). Armed "
        f"{row['armings']} times. In the last session the device accepted {device['accepted']:,}, missed "
        f"{device['missing']:,}, found {device['stale']:,} stale, refused {device['refused']:,}; of its own frames "
        f"{lost:,} did not come. At most {row['most_in_flight']:.1f} frames on their way to it. Load of "
        f"the machine meanwhile, other work included: {row['load'][0]:.0f} to {row['load'][1]:.0f}, on "
        f"{row['processors']} processors."
    )
