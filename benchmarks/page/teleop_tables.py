"""The page of the teleoperation in Markdown, from the report that the JSON holds too."""

from collections.abc import Callable

import numpy as np

from benchmarks.page.tables import table


def page(report: dict) -> str:
    facts = report["machine"]
    parts = [
        "# Teleoperation: a robot hand with and without forces back",
        f"Made by `python -m benchmarks.teleop`. {facts['processor']}, {facts['system']}, Python {facts['python']}. A "
        "Shadow hand on a compliant arm in MuJoCo, a simulated person, a simulated network with messages at 250 Hz. "
        "The person and all its numbers are a model of ours (`jaxgrasp.teleop.PersonModel`): what the forces bring is "
        "what they bring to this model. A person without forces sees what happens, late by the network, and answers "
        "after 0.25 s; with forces the same person also feels a contact, and answers after 0.15 s. Forces on the "
        "fingers are a glove's; one on the wrist, by a simulated arm master, moves the arm against its stiffness.",
    ]
    writers: dict[str, Callable] = {
        "peg": _peg,
        "delayed_peg": lambda rows: _delayed("Peg in hole, over a network", rows),
        "delayed_stack": lambda rows: _delayed("Stacking a block, over a network", rows),
        "picture": _picture,
        "film": _film,
        "retargeting": _retargeting,
        "passivity": _passivity,
    }
    parts += [write(report[name]) for name, write in writers.items() if name in report]
    return "\n\n".join(parts) + "\n"


def peak_reduction(rows: list[dict], felt: str) -> float:
    """Return the share by which the mean peak force with these forces is lower than that with none."""
    peaks = {kind: np.mean([row["peak_force"] for row in rows if row["felt"] == kind]) for kind in (felt, "nothing")}
    return float(1 - peaks[felt] / peaks["nothing"])


def _peg(rows: list[dict]) -> str:
    seeds = len({row["seed"] for row in rows})
    both, fingers = (peak_reduction(rows, felt) for felt in ("fingers and wrist", "fingers"))
    return (
        f"## Peg in hole, without delay\n\nThe same {seeds} seeds with each kind of forces and without. The mean peak "
        f"of the contact force is {both:.0%} lower with forces on fingers and wrist, and {fingers:.0%} lower with "
        f"those on the fingers alone.\n\n{_conditions(rows)}"
    )


def _delayed(title: str, rows: list[dict]) -> str:
    seeds = len({row["seed"] for row in rows})
    return (
        f"## {title}\n\n{seeds} seeds of each row; up to 20 ms of jitter and 5 % loss are added to the delay, each "
        f"way, of messages and picture.\n\n{_conditions(rows)}"
    )


def _conditions(rows: list[dict]) -> str:
    heads = [
        "delay [ms]",
        "forces on",
        "done",
        "dropped",
        "mistaken",
        "out of time",
        "time of those done [s]",
        "peak force, mean [N]",
        "peak force, 90 % [N]",
        "mean force [N]",
        "energy by the person [mJ]",
        "by the robot [mJ]",
        "least sum [mJ]",
    ]
    lines = []
    for delay, felt in dict.fromkeys((row["delay"], row["felt"]) for row in rows):
        group = [row for row in rows if (row["delay"], row["felt"]) == (delay, felt)]
        done = [row["seconds"] for row in group if row["is_success"]]
        reasons = [row["reason"] for row in group]
        peaks = [row["peak_force"] for row in group]
        lines.append(
            [
                delay,
                felt,
                *(f"{reasons.count(reason)} of {len(group)}" for reason in ("done", "dropped", "not done", "time")),
                f"{np.mean(done):.1f}" if done else "-",
                f"{np.mean(peaks):.1f}",
                f"{np.quantile(peaks, 0.9):.1f}",
                f"{np.mean([row['mean_force'] for row in group]):.1f}",
                f"{1e3 * np.mean([row['person_energy'] for row in group]):.1f}",
                f"{1e3 * np.mean([row['robot_energy'] for row in group]):.1f}",
                f"{1e3 * min(row['least_net_energy'] for row in group):.2f}",
            ]
        )
    return table(heads, lines)


def _picture(facts: dict) -> str:
    return (
        "![Height of the peg, contact force and torque of one trial of each kind](teleop.png)\n\n"
        f"One trial of each, with the seed {facts['seed']}."
    )


def _film(facts: dict) -> str:
    return (
        "![Film of the trial with forces on fingers and wrist](teleop.gif)\n\nThe first of these trials, seed "
        f"{facts['seed']}."
    )


def _retargeting(rows: list[dict]) -> str:
    heads = ["method", "median [ms]", "90 % [ms]", "mean error [mm]", "largest error [mm]", "largest change [rad]"]
    lines = [
        [
            row["method"],
            f"{row['median_ms']:.2f}",
            f"{row['ninety_ms']:.2f}",
            f"{row['error_mm']:.1f}",
            f"{row['largest_error_mm']:.1f}",
            f"{row['largest_jump']:.3f}",
        ]
        for row in rows
        if "method" in row
    ]
    return (
        "## Retargeting\n\nA hand that closes and opens, 250 postures a second. Times are of the processor, on a "
        "machine that others used too; the error is that of the Shadow hand's fingertips from their targets. Damped "
        "least squares also keeps the distances of thumb and fingers, which the other objective has no term for; its "
        "optimiser is SciPy's SLSQP with JAX's gradient, in place of NLopt's.\n\n" + table(heads, lines)
    )


def _passivity(facts: dict) -> str:
    return (
        f"## Energy of the network\n\nIn {facts['runs']:,} random runs (motions up to 4 Hz, walls, delays to 200 ms, "
        f"jitter, losses to 30 %) the least net energy into the network was {facts['controlled_mJ']:.2f} mJ with the "
        f"two-port passivity controllers; in the first {facts['free_runs']:,} of them it was {facts['free_mJ']:.0f} mJ "
        "without."
    )
