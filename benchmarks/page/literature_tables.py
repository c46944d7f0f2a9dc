"""The page of the literature's methods in Markdown, from the report that the JSON holds too."""

from benchmarks.page.tables import made_by, table

QUALITY = [
    "method",
    "µs a problem",
    "F_2 above optimum",
    "F_3 above optimum",
    "worst margin [degrees]: median (least)",
    "normal forces, sum [N]",
    "largest residual",
    "cone violation",
    "outside",
    "statuses",
]


def page(report: dict) -> str:
    cases = list(dict.fromkeys(row["case"] for row in report["rows"]))
    sections = [
        "# The methods that the paper names, against its closed forms and their optima",
        _preface(report),
        *(part for case in cases for part in _case(case, [row for row in report["rows"] if row["case"] == case])),
        "## What the compact dual saves",
        "The linear program of Orin and Oh, as it stands and as Cheng and Orin's compact dual: what the simplex method "
        "is given, bounds of unknowns aside, its pivots, and the time once the program stands (elimination included). "
        f"SciPy's interface takes {report['overhead_microseconds']:,.0f} µs of it for a program of one unknown.",
        table(["n", "form", "rows", "columns", "nonzeros", "pivots", "µs a program"], map(_compact, report["compact"])),
    ]
    return "\n\n".join(sections) + "\n"


def _preface(report: dict) -> str:
    facts, setting = report["machine"], report["setting"]
    return (
        f"{made_by('literature', facts, ('jax', 'scipy'))}.\n\n"
        f"{setting['count']} ordinary problems of each size, and the paper's rotating cylinder every "
        f"{1e3 * setting['step']:.0f} ms. Times are medians of turns in one process, for the whole batch in one call, "
        "checks of the data included; the linear and quadratic programs are a loop on the host, and of each "
        f"{report['overhead_microseconds']:,.0f} µs are SciPy's own. Pyramids have {setting['sides']} inscribed sides. "
        f"Methods that take bounds may press with {setting['bound']:.0f} times the largest normal force of method A's "
        "optimum (for the cylinder: of all its instants).\n\n"
        "Each method minimises a measure of its own: what lies above the optimum of F_2 (eq. 5) or F_3 (eq. 13), in "
        "the median and relative to it or to what no force would cost, is no error but the price of another aim; it is "
        "negative where forces leave the cones. Margins are atan(mu) less the slip angle of the worst contact that "
        "carries more than a millionth of the largest force. Residuals are backward errors; violations are distances "
        "from the cone, relative to the largest force or squeeze; outside are answers with one above 1e-6. Problems "
        "without an answer count in no column but the last."
    )


def _case(title: str, rows: list[dict]) -> list[str]:
    parts = [f"## {title[0].upper()}{title[1:]}", table(QUALITY, map(_quality, rows))]
    if "largest_jump" in rows[0]:
        parts += [
            "How forces move from an instant to the next: the largest change of a contact's force, and the root mean "
            "square of its second differences.",
            table(["method", "largest jump [N]", "second differences [N]"], map(_smooth, rows)),
        ]
    return parts


def _quality(row: dict) -> list[str]:
    least = row["margin_degrees_least"]
    return [
        row["method"],
        f"{row['microseconds']:,.1f}",
        _percent(row["excess_f2_median"]),
        _percent(row["excess_f3_median"]),
        "-" if least is None else f"{row['margin_degrees_median']:.2f} ({least:.2f})",
        "-" if row["normal_force_median"] is None else f"{row['normal_force_median']:,.1f}",
        _power(row["largest_residual"]),
        _power(row["largest_violation"]),
        f"{row['outside_cones']:,} of {row['given']:,}",
        ", ".join(f"{word.lower().replace('_', ' ')} {count:,}" for word, count in row["statuses"].items()),
    ]


def _smooth(row: dict) -> list[str]:
    return [row["method"], _figures(row["largest_jump"]), _figures(row["second_difference_rms"])]


def _compact(row: dict) -> list[str]:
    sizes = [f"{row[name]:,}" for name in ("rows", "columns", "nonzeros")]
    return [str(row["n"]), row["form"], *sizes, f"{row['pivots']:.1f}", f"{row['microseconds']:,.0f}"]


def _percent(share: float | None) -> str:
    return "-" if share is None else f"{100 * share:,.2f} %"


def _power(value: float | None) -> str:
    return "-" if value is None else f"{value:.0e}"


def _figures(value: float | None) -> str:
    return "-" if value is None else f"{value:.3g}"
