"""The headline of the report: a few large numbers, each in a sentence that says what it counts."""

import math
from dataclasses import dataclass

from jaxgrasp.batch.chunk_statistics import LogHistogram
from jaxgrasp.batch.reasons import Reason
from jaxgrasp.batch.summary import Summary
from jaxgrasp.model.solution import Verdict
from jaxgrasp.report.look import METHOD_COLOURS, NOTHING, counted, format_count, share, short_percentage, swatch

WHATEVER_THE_FRICTION = (Reason.LINE, Reason.POINT, Reason.PULL, Reason.NO_CONTACTS)
SOLVED = (Verdict.CLOSED_FORM_OPTIMAL, Verdict.OPTIMAL)


@dataclass(frozen=True)
class Tile:
    """A heading, large numbers with the method that each belongs to, and a sentence."""

    heading: str
    numbers: list[tuple[str, str]]
    sentence: str

    def html(self) -> str:
        large = "".join(
            f'<div class="row">{label}<span class="large">{value}</span></div>' for label, value in self.numbers
        )
        return f'<section class="tile"><h2>{self.heading}</h2>{large}<p>{self.sentence}</p></section>'


def unit(summary: Summary) -> str:
    """Return the unit of counts: "grasp", or "problem" if grasps have several wrenches, a problem for each."""
    return "grasp" if summary.problems == summary.grasps else "problem"


def tiles(summary: Summary) -> list[Tile]:
    """Return the tiles for the evaluated methods, the most important first."""
    return [*holding_tiles(summary), *comparing_tiles(summary)]


def holding_tiles(summary: Summary) -> list[Tile]:
    """Return tiles that count the problems that hold and those that no forces within friction can hold."""
    return [*_holding(summary), *_infeasible(summary)]


def comparing_tiles(summary: Summary) -> list[Tile]:
    """Return tiles that compare closed forms with their optima."""
    right = [tile for name in "AB" for tile in _right_as_it_stands(summary, name)]
    return [*right, *_price(summary), *_deceiving(summary)]


def tiles_html(tiles: list[Tile]) -> str:
    return '<div class="tiles">' + "".join(tile.html() for tile in tiles) + "</div>"


def _optimum(summary: Summary) -> str | None:
    """Return the name of the optimum that decides the hold: A-optimum if evaluated, else B-optimum, else None."""
    return next((name for name in ("A-optimum", "B-optimum") if name in summary.methods), None)


def _holding(summary: Summary) -> list[Tile]:
    name = _optimum(summary)
    if name is None:
        return []
    holds = summary.methods[name].count(*SOLVED)
    sentence = (
        f"{format_count(holds)} of {counted(summary.problems, unit(summary))}: there are contact forces inside every "
        "friction cone that give the wrench."
    )
    b_optimum = summary.methods.get("B-optimum")
    if name == "A-optimum" and b_optimum is not None and b_optimum.count(*SOLVED) != holds:
        sentence += (
            f" By B's optimum, whose contacts of no squeeze carry nothing, {format_count(b_optimum.count(*SOLVED))} do."
        )
    if summary.ranked is not None and summary.ranked.harder:
        sentence += (
            f" Of {format_count(summary.ranked.harder)} they press harder in all than the hand means to squeeze."
        )
    return [Tile("Hold with friction", [("", share(holds, summary.problems))], sentence)]


def _right_as_it_stands(summary: Summary, name: str) -> list[Tile]:
    optimum, closed = summary.methods.get(f"{name}-optimum"), summary.methods.get(name)
    either = optimum or closed
    if either is None:
        return []
    right = either.count(Verdict.CLOSED_FORM_OPTIMAL)
    if optimum is not None:
        total, among = optimum.count(*SOLVED), "that hold"
    else:
        total, among = summary.problems, "in all"
    equation = {"A": "eq. 11", "B": "eq. 15"}[name]
    sentence = (
        f"{format_count(right)} of the {format_count(total)} {among}: the forces of {equation} lie inside "
        "every friction cone, so they are the constrained optimum and nothing has to be solved."
    )
    return [Tile(f"Closed form {name} is right as it stands", [(_label(name), share(right, total))], sentence)]


def _price(summary: Summary) -> list[Tile]:
    rows = [(_label(name), three_quantiles(comparison.price)) for name, comparison in summary.comparisons.items()]
    if not rows:
        return []
    binding = []
    for name, comparison in summary.comparisons.items():
        bound = LogHistogram(comparison.price.counts, 0, comparison.price.largest)
        if bound.total:
            binding.append(f"about {short_percentage(bound.quantile(0.5))} for {name}")
    sentence = (
        "About the median and 95%, and the largest, over all that hold: the share (F* \N{MINUS SIGN} F) / F* of the "
        "optimum's objective F* that the closed form, at F, leaves out by ignoring friction."
    )
    if binding:
        sentence += f" Where it is not zero, its median is {' and '.join(binding)}."
    return [Tile("Price of friction", rows, sentence)]


def three_quantiles(histogram: LogHistogram) -> str:
    if histogram.total == 0:
        return NOTHING
    return " <i>·</i> ".join(short_percentage(histogram.quantile(q)) for q in (0.5, 0.95, 1.0))


def _deceiving(summary: Summary) -> list[Tile]:
    """Return a tile that counts closed forms that violate friction though feasible forces exist."""
    rows, notes = [], []
    for name in "AB":
        closed, optimum = summary.methods.get(name), summary.methods.get(f"{name}-optimum")
        if closed is None:
            continue
        outside = closed.count(Verdict.OUTSIDE_CONES)
        if optimum is None:
            rows.append((_label(name), share(outside, summary.problems)))
            notes.append(
                f"{name}: {format_count(outside)}, whether or not allowed forces exist, which was not evaluated."
            )
            continue
        avoidable = optimum.count(Verdict.OPTIMAL)
        rows.append((_label(name), share(avoidable, summary.problems)))
        # What the contacts cannot reach at all, the closed form calls infeasible too.
        forbidden = max(0, optimum.count(Verdict.INFEASIBLE) - closed.count(Verdict.INFEASIBLE))
        notes.append(
            f"{name}: {format_count(avoidable)} though allowed forces exist, and {format_count(forbidden)} where none "
            "do."
        )
    if not rows:
        return []
    sentence = "The closed form balances the wrench, but a contact slips or pulls. "
    return [Tile("The closed form deceives", rows, sentence + " ".join(notes))]


def _infeasible(summary: Summary) -> list[Tile]:
    name = _optimum(summary)
    if name is None:
        return []
    summary_of_method = summary.methods[name]
    proved = summary_of_method.count(Verdict.INFEASIBLE, Verdict.NO_CONTACTS)
    sentence = (
        f"{counted(proved, unit(summary))}: no allowed forces give the wrench, and a certificate proves it, a motion "
        "of the object that the load drives and no contact can resist."
    )
    if proved == 0:
        sentence = f"No {unit(summary)} was proved to have no allowed forces."
    if proved and summary.ranked is not None:
        beyond = int(sum(summary.ranked.counts[reason] for reason in WHATEVER_THE_FRICTION))
        sentence += f" {format_count(beyond)} of them stay out of reach whatever the friction."
    if math.isfinite(summary_of_method.least_force_bound):
        sentence += (
            f" What is proven reaches to {summary_of_method.least_force_bound:.2g} N of normal force in all, at least."
        )
    undecided = summary_of_method.count(Verdict.NOT_CONVERGED)
    sentence += f" Not decided: {format_count(undecided)}." if undecided else " None was left undecided."
    unsure = summary_of_method.count(Verdict.FEASIBLE)
    sentence += f" Held, but perhaps not by the optimum: {format_count(unsure)}." if unsure else ""
    invalid = summary_of_method.count(Verdict.INVALID_DATA)
    sentence += f" Invalid data: {format_count(invalid)}." if invalid else ""
    return [Tile("Cannot hold", [("", share(proved, summary.problems))], sentence)]


def _label(name: str) -> str:
    return f'<span class="name">{swatch(METHOD_COLOURS[name])}{name}</span>'
