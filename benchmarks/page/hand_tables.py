"""The virtual hand's page in Markdown, from the report that the JSON holds too."""

from benchmarks.page.tables import NOTHING, made_by, power, table

ERRORS = {
    "closed_form_force_error": "closed form's forces",
    "closed_form_backward_error": "its balance",
    "optimum_gap": "optimum's gap",
    "optimum_backward_error": "its balance",
    "optimum_violation": "cone violation",
    "max_torque_error": "torques",
}


def page(report: dict) -> str:
    rows = report["rows"]
    parts = list(rows[0]["batch_microseconds"])
    wide = [row for row in rows if row["dtype"] == "float64"]
    return (
        "\n\n".join(
            [
                "# The virtual hand: Table II again",
                _preface(report),
                "## One pose at a time [µs]",
                f"Medians of interleaved turns and of {report['plan']['singles']} poses, float64; in brackets the tick "
                "of the slowest of them. The paper's time is that of the forces alone.",
                table(["contacts", "paper", *parts], [_alone(row, parts, report["paper_ms"]) for row in wide]),
                f"## {rows[0]['batch']:,} poses at a time [µs a pose]",
                table(["contacts", "precision", *parts], [_batched(row, parts) for row in rows]),
                _devices(report["devices_microseconds"]),
                "## What touched (float64)",
                table(TOUCHED, [_touched(row) for row in wide]),
                "## What the answers are worth",
                "Relative errors, the worst of the judged poses that the verdict calls answered, against references in "
                "extended precision; the torques' against the contacts' Jacobian. *Wrong* counts claims, of solution "
                "or of infeasibility, that break a law of `benchmarks/laws.py`.",
                table(["contacts", "precision", "judged", "wrong", *ERRORS.values()], [_worth(row) for row in rows]),
            ]
        )
        + "\n"
    )


def _preface(report: dict) -> str:
    facts, setting = report["machine"], report["setting"]
    radii = ", ".join(f"{1e3 * radius:.0f}" for radius in setting["radii"])
    whole_hand = next(row for row in report["rows"] if row["case"] == "whole hand")
    return (
        f"{made_by('virtual_hand', facts, facts['versions'])}.\n\n"
        f"A human hand with palm pads holds a sphere of {setting['mass']} kg with friction {setting['friction']}, "
        "turned every way: by 3 and by 5 fingertips, else in a spherical power grip. Radii, in order of the contacts: "
        f"{radii} mm. From pose to pose each joint's angle differs by {setting['turn']} rad and the object's place by "
        f"{1e3 * setting['shift']:.1f} mm (standard deviations). For n contacts the hand has the n links that touch. "
        f"The whole hand holds a sphere of {1e3 * setting['whole_radius']:.0f} mm: "
        f"of its {whole_hand['contacts']} links "
        f"{whole_hand['mean_present']:.1f} touch in the mean. A tick is posture to contacts, both force "
        "distributions with their verdicts, and joint torques. Its parts are timed each by itself, on what the tick "
        "hands them."
    )


def _devices(times: dict) -> str:
    times_text = " and ".join(f"{time:.1f} µs a pose on {number}" for number, time in times.items())
    return f"The whole hand's tick in float64, on devices that have a core each, in a process of its own: {times_text}."


def _alone(row: dict, parts: list[str], paper: dict) -> list[str]:
    times = row["single_microseconds"]
    # Keys are numbers in the report, and strings once it has been JSON.
    paper_times = {str(n): milliseconds for n, milliseconds in paper.items()}
    before = f"{paper_times[row['case']] * 1e3:,.0f}" if row["case"] in paper_times else NOTHING
    slowest = f"{times['tick']:.0f} ({row['slowest_single_tick_microseconds']:.0f})"
    return [row["case"], before, slowest, *(f"{times[part]:.0f}" for part in parts[1:])]


def _batched(row: dict, parts: list[str]) -> list[str]:
    return [row["case"], row["dtype"], *(f"{row['batch_microseconds'][part]:.2f}" for part in parts)]


TOUCHED = ["contacts", "present", "all present", "sphere tests", "cones active", "Newton steps"]
TOUCHED += ["closed form", "optimum"]


def _touched(row: dict) -> list[str]:
    return [
        row["case"],
        f"{row['mean_present']:.2f} of {row['contacts']}",
        f"{row['all_present_share']:.2f}",
        f"{row['sphere_tests']:.0f}",
        f"{row['active_share']:.3f}",
        f"{row['mean_newton_steps']:.1f}",
        _verdict_counts(row["closed_form_verdicts"]),
        _verdict_counts(row["optimum_verdicts"]),
    ]


def _verdict_counts(verdicts: dict[str, int]) -> str:
    return ", ".join(f"{count:,} {name}" for name, count in verdicts.items())


def _worth(row: dict) -> list[object]:
    return [row["case"], row["dtype"], row["judged"], row["wrong"], *(power(row[key]) for key in ERRORS)]
