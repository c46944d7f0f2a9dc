"""Plain text of a summary, for the terminal."""

import math
import textwrap

from jaxgrasp.batch.chunk_statistics import (
    LEAST_FRICTION,
    MARGIN,
    LogHistogram,
    case_title,
    ranking_title,
    without_rounding,
)
from jaxgrasp.batch.engine import Times
from jaxgrasp.batch.qualities import quality_line
from jaxgrasp.batch.reasons import Reason
from jaxgrasp.batch.summary import Summary
from jaxgrasp.files.printable import printable
from jaxgrasp.model.solution import METHODS, Route, Verdict

_ROWS = (
    ("holds inside every cone", (Verdict.CLOSED_FORM_OPTIMAL, Verdict.OPTIMAL)),
    ("  closed form as it is", (Verdict.CLOSED_FORM_OPTIMAL,)),
    ("  needs the optimum", (Verdict.OPTIMAL,)),
    ("holds, perhaps not the optimum", (Verdict.FEASIBLE,)),
    ("balances, but slips or pulls", (Verdict.OUTSIDE_CONES,)),
    ("no forces exist", (Verdict.INFEASIBLE,)),
    ("no loaded contact", (Verdict.NO_CONTACTS,)),
    ("not decided", (Verdict.NOT_CONVERGED,)),
    ("invalid data", (Verdict.INVALID_DATA,)),
)


WHAT_A_AND_B_ARE = (
    "A shares the load alike among the contacts, B by how hard each squeezes (eqs. 11 and 15); both ignore friction, "
    "which their optima heed."
)
LISTED_CASES = 3
_SOLVER_ROUTES = (Route.CLOSED_FORM, Route.NEWTON, Route.ROBUST)


def summary_text(summary: Summary, times: Times, seconds: float, details: bool = True) -> str:
    """Return the summary in plain text: what was read and which grasps hold, and then the details.

    The details are the statistics of each method, and of closed forms against their optima.
    """
    lines = [_what_was_read(summary), "", *_which_hold(summary)]
    if details:
        lines += [*_method_lines(summary, times), ""]
    if summary.qualities:
        lines += [*(quality_line(name, quality) for name, quality in summary.qualities.items()), ""]
    lines.append(_closing(summary, times, seconds, details))
    return "\n".join(lines)


def _method_lines(summary: Summary, times: Times) -> list[str]:
    """Return a table of the methods' verdicts, and closed forms against their optima."""
    names, lines = list(summary.methods), list[str]()
    lines.append(f"{'':30}" + "".join(f"{name:>14}" for name in names))
    for label, verdicts in _ROWS:
        counts = [summary.methods[name].count(*verdicts) for name in names]
        if any(counts):
            lines.append(f"{label:30}" + "".join(f"{_share(count, summary.problems):>14}" for count in counts))
    bounds = [summary.methods[name].least_force_bound for name in names]
    if any(map(math.isfinite, bounds)):
        cells = (f"{bound:.2g} N" if math.isfinite(bound) else "-" for bound in bounds)
        lines.append(f"{'  by as much force, at least':30}" + "".join(f"{text:>14}" for text in cells))
    margins = [summary.methods[name].smallest_margin for name in names]
    lines.append(f"{'worst friction margin':30}" + "".join(f"{_degrees(margin):>14}" for margin in margins))
    if times.problems:
        costs = [times.solving[name] / times.problems for name in names]
        lines.append(f"{'time per grasp and wrench':30}" + "".join(f"{_duration(cost):>14}" for cost in costs))
    if summary.comparisons:
        lines += ["", *_comparison_lines(summary)]
    return lines


def _which_hold(summary: Summary) -> list[str]:
    """Return lines on the grasps that hold, the reasons of the others, and the best and worst of each order."""
    ranked, several = summary.ranked, summary.problems != summary.grasps
    if ranked is None or not summary.problems:
        return []
    unit = "problems" if several else "grasps"
    lines = [f"{ranked.holds:,} of {summary.problems:,} {unit} hold ({ranked.judge})."]
    if ranked.harder:
        cases = ranked.examples.get(Reason.HARDER.name, [])
        factors = "; ".join(
            f"{printable(case_title(case, several))}: {times_harder(case.get('squeeze_factor', math.nan))} times"
            for case in cases
        )
        more = "; ..." if ranked.harder > len(cases) else ""
        lines.append(f"  {ranked.harder:,} more if the hand squeezes harder ({factors}{more})")
    for reason, count in ranked.failing:
        names = "; ".join(printable(case_title(case, several)) for case in ranked.examples.get(reason.name, []))
        more = "; ..." if count > len(ranked.examples.get(reason.name, [])) else ""
        lines.append(f"  {count:,} not: {reason.title} ({names}{more})")
    for name, ranking in ranked.rankings.items():
        by_wrench = several and name in (MARGIN, LEAST_FRICTION)
        for end, cases in ranking.ends():
            listed = "; ".join(
                f"{printable(case_title(case, by_wrench))} {ranked_value(name, case['value'])}"
                for case in cases[:LISTED_CASES]
            )
            if listed:
                lines.append(f"{end} by {ranking_title(name)}: {listed}")
    return [*lines, ""]


def ranked_value(name: str, value: float) -> str:
    """Format a value that grasps are ranked by; margins in degrees with their unit, others as numbers."""
    if name == MARGIN:
        return _degrees(value)
    return f"{without_rounding(value):.3g}"


def times_harder(factor: float) -> str:
    """Return a factor on squeezing forces with one decimal, or as whole where it is large; never rounded down."""
    return f"{math.ceil(10 * factor) / 10:.1f}" if factor < 100 else f"{math.ceil(min(factor, 1e15)):,}"


def _what_was_read(summary: Summary) -> str:
    sizes = [n for n, count in enumerate(summary.sizes) if count]
    if not sizes:
        return f"no usable grasps; {summary.set_aside:,} bad grasps set aside"
    span = f"{sizes[0]}" if len(sizes) == 1 else f"{sizes[0]} to {sizes[-1]}"
    text = f"{summary.grasps:,} grasps of {span} contacts, {summary.contacts:,} contacts in all"
    if summary.problems != summary.grasps:
        text += f", {summary.problems:,} wrenches"
    if summary.set_aside:
        text += f"; {summary.set_aside:,} bad grasps set aside"
    return text


def _comparison_lines(summary: Summary) -> list[str]:
    lines = [
        *textwrap.wrap(WHAT_A_AND_B_ARE, 100),
        f"{'Against its own optimum':30}{'median':>14}{'95%':>14}{'largest':>14}",
    ]
    for name, comparison in summary.comparisons.items():
        lines.append(_quantiles(f"{name}: price of friction", comparison.price, _percent))
        lines.append(_quantiles(f"{name}: distance in force", comparison.distance, _percent))
        lines.append(_quantiles(f"{name}: force beyond friction", comparison.violation, _newtons))
    return lines


def _quantiles(label: str, histogram: LogHistogram, show) -> str:
    # Those of a histogram are known to half of its bins; the largest is exact.
    about = [f"~{show(value, 2)}" if (value := histogram.quantile(share)) else "0" for share in (0.5, 0.95)]
    return f"{label:30}" + "".join(f"{cell:>14}" for cell in (*about, show(histogram.quantile(1.0), 3)))


def _closing(summary: Summary, times: Times, seconds: float, details: bool) -> str:
    text = f"{_duration(seconds)} in all, {_duration(times.compiling)} of it compiling."
    optima = [m.routes for name, m in summary.methods.items() if METHODS[name].constrained]
    if optima and details:
        skipped, fast, careful = (int(sum(routes[route] for routes in optima)) for route in _SOLVER_ROUTES)
        text += f"\nOptima: {skipped:,} skipped, the closed form being one; {fast:,} found fast, {careful:,} with care."
    return text


def _share(count: int, total: int) -> str:
    return f"{100 * count / max(1, total):.1f} %" if count else "-"


def _degrees(angle: float) -> str:
    # An optimum on its cone's surface has a margin of rounding: do not print -0.0.
    return f"{round(math.degrees(angle), 1) + 0.0:.1f} deg" if math.isfinite(angle) else "-"


def _percent(value: float, digits: int) -> str:
    return f"{100 * value:.{digits}g} %" if value else "0"


def _newtons(value: float, digits: int) -> str:
    return f"{value:.{digits}g} N" if value else "0"


def _duration(seconds: float) -> str:
    for unit, size in (("s", 1), ("ms", 1e-3), ("us", 1e-6)):
        if seconds >= size:
            return f"{seconds / size:.3g} {unit}"
    return f"{seconds * 1e9:.3g} ns"
