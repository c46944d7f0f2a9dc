"""The sphere trees' page in Markdown, from the report that the JSON holds too."""

from benchmarks.page.tables import made_by, table

LEFT_OUT = ["levels", "cell [mm]", "balls", "mean [mm]", "largest [mm]", "built in [s]"]
TIMES = ["levels", "balls", "all [µs]", "descent [µs]", "ratio", "tests, all", "tests, descent", "differ by"]


def page(report: dict) -> str:
    rows = report["rows"]
    return (
        "\n\n".join(
            [
                "# Sphere trees: error and time by level",
                _preface(report),
                "## What the balls leave out",
                "The surface's distance from the balls, at points spread evenly over it; all balls lie inside.",
                table(
                    ["levels", "cell [mm]", "balls", "mean [mm]", "largest [mm]", "built in [s]"], map(_left_out, rows)
                ),
                "## Contacts against those with the exact cylinder",
                f"Those up to {1e3 * report['setting']['shallow']:.0f} mm deep; medians, and the largest in brackets.",
                table(["levels", "contacts", "missed", "depth [mm]", "normal [degrees]"], map(_contacts, rows)),
                "## All balls, or a descent",
                "Microseconds a pose, and spheres tried against spheres. Both find the same contacts.",
                table(
                    [
                        "levels",
                        "balls",
                        "all [µs]",
                        "descent [µs]",
                        "ratio",
                        "tests, all",
                        "tests, descent",
                        "differ by",
                    ],
                    map(_times, rows),
                ),
                _crossover(rows),
            ]
        )
        + "\n"
    )


def _preface(report: dict) -> str:
    facts, setting = report["machine"], report["setting"]
    return (
        f"{made_by('sphere_trees', facts, ('jax',))}.\n\n"
        f"A human hand in a power grip on a cylinder of {1e3 * setting['radius']:.0f} mm radius and "
        f"{1e3 * setting['height']:.0f} mm height, {setting['poses']} poses that differ by "
        f"{1e3 * setting['shift']:.1f} mm (standard deviation)."
    )


def _left_out(row: dict) -> list[str]:
    largest, mean = (f"{1e3 * row[name]:.2f}" for name in ("left_out_largest", "left_out_mean"))
    return [
        str(row["levels"]),
        f"{1e3 * row['cell']:.1f}",
        f"{row['balls']:,}",
        mean,
        largest,
        f"{row['build_seconds']:.1f}",
    ]


def _contacts(row: dict) -> list[str]:
    return [
        str(row["levels"]),
        f"{row['judged']:,}",
        f"{100 * row['missed_share']:.1f} %",
        f"{1e3 * row['depth_error_median']:.2f}",
        f"{row['normal_error_degrees_median']:.1f} ({row['normal_error_degrees_largest']:.1f})",
    ]


def _times(row: dict) -> list[str]:
    microseconds, tests = row["microseconds"], row["tests"]
    return [
        str(row["levels"]),
        f"{row['balls']:,}",
        f"{microseconds['all']:,.0f}",
        f"{microseconds['descent']:,.0f}",
        f"{microseconds['all'] / microseconds['descent']:.1f}",
        f"{tests['all']:,.0f}",
        f"{tests['descent']:,.0f}",
        f"{row['ways_differ']:.0e}",
    ]


def _crossover(rows: list[dict]) -> str:
    """State the size from which on a descent is faster."""
    faster = [row["microseconds"]["descent"] < row["microseconds"]["all"] for row in rows]
    if all(faster):
        return f"A descent is faster from {rows[0]['balls']:,} balls on, the fewest that were measured."
    slower = [row["balls"] for row, fast in zip(rows, faster, strict=True) if not fast]
    return f"Trying all is faster at {', '.join(f'{balls:,}' for balls in slower)} balls."
