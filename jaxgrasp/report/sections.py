"""The parts of the report's page: a headline of a few large numbers, and each figure with sentences that define it."""

import math
from collections.abc import Callable
from dataclasses import dataclass

from jaxgrasp.batch.chunk_statistics import LogHistogram
from jaxgrasp.batch.engine import Times
from jaxgrasp.batch.qualities import APART
from jaxgrasp.batch.reasons import Reason
from jaxgrasp.batch.summary import Summary
from jaxgrasp.model.solution import Verdict
from jaxgrasp.report import figures
from jaxgrasp.report.bundle import embedded
from jaxgrasp.report.look import (
    METHOD_COLOURS,
    NOTHING,
    VERDICT_COLOURS,
    VERDICT_TITLES,
    counted,
    degrees,
    format_count,
    method_title,
    number,
    percentage,
    seconds,
    share,
    short_percentage,
    swatch,
    table,
    text,
)

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


QUANTITIES = (
    (
        "price",
        "Price of friction",
        "(F* \N{MINUS SIGN} F) / F*",
        "The share of the optimum's objective F* that the closed form, at F ≤ F*, leaves out by ignoring friction.",
        percentage,
    ),
    (
        "distance",
        "Force distance",
        "|f \N{MINUS SIGN} f*| / |f*|",
        "How far the closed form's forces f lie from the optimum's f*, over all contacts of a grasp.",
        number,
    ),
    (
        "violation",
        "Cone violation [N]",
        "max(|t| \N{MINUS SIGN} μ n, 0) [N]",
        "The closed form's tangential force |t| beyond friction's limit μ n, at its worst contact.",
        lambda value: f"{number(value)} N",
    ),
)


def figure_html(name: str, figure: dict) -> str:
    """Return a placeholder of the figure's height, so that the page does not jump, and the figure's data."""
    height = f"min-height:{figure['layout']['height']}px"
    return f'<div class="figure" data-figure="{name}-data" style="{height}"></div>' + embedded(f"{name}-data", figure)


def verdicts_html(summary: Summary) -> str:
    """Return a bar chart of the verdicts, and a table of exact counts with the meaning of each verdict."""
    if not summary.methods or not summary.problems:
        return "<p class='note'>Nothing was evaluated.</p>"
    rows = [
        [
            f"{swatch(VERDICT_COLOURS[verdict])}{VERDICT_TITLES[verdict]}",
            *(format_count(method.count(verdict)) for method in summary.methods.values()),
            f'<span class="wide">{text(verdict.advice)}</span>',
        ]
        for verdict in Verdict
    ]
    head = [
        "verdict",
        *(f"<span class='name'>{method_title(name)}</span>" for name in summary.methods),
        "<span class='wide'>what it means</span>",
    ]
    note = (
        "Closed forms A and B balance the wrench and only monitor friction; each optimum adds the friction cones to "
        "the same objective."
    )
    counts = f"<details><summary>Exact counts, and what each verdict means</summary>{table(head, rows)}</details>"
    return f'<p class="note">{note}</p>{figure_html("verdicts", figures.verdict_bars(summary))}{counts}'


def distributions_html(summary: Summary) -> str:
    """Return the distributions of three quantities, with closed forms A and B on the same axes."""
    if not any(comparison.compared for comparison in summary.comparisons.values()):
        return (
            "<p class='note'>Nothing to compare: it takes a closed form, its optimum, and a problem that has one.</p>"
        )
    panels = []
    for field, title, label, meaning, shown in QUANTITIES:
        histograms = {name: getattr(comparison, field) for name, comparison in summary.comparisons.items()}
        figure = figures.distribution(histograms, label)
        drawn = figure_html(field, figure) if figure else '<p class="empty">All values are zero.</p>'
        heading = f'<h3>{title}</h3><p class="note">{meaning}</p>'
        panels.append(f'<div class="panel3">{heading}{drawn}{_quantiles(histograms, shown)}</div>')
    note = (
        "Closed form against its own optimum, over all problems that have one. Where the closed form is already "
        "optimal all three are exactly zero, which a logarithmic axis cannot show: the tables give that share."
    )
    return f'<p class="note">{note}</p><div class="three">{"".join(panels)}</div>'


def _quantiles(histograms: dict[str, LogHistogram], shown) -> str:
    rows = [
        [
            f"{swatch(METHOD_COLOURS[name])}{name}",
            share(histogram.zeros, histogram.total),
            *((about(shown, histogram.quantile(q)) if histogram.total else NOTHING) for q in (0.5, 0.95)),
            shown(histogram.largest) if histogram.total else NOTHING,
        ]
        for name, histogram in histograms.items()
    ]
    return table(["", "exactly 0", "median", "95%", "largest"], rows, "tight")


def about(shown: Callable[[float], str], value: float) -> str:
    """Format a quantile of a histogram to two digits after "~", for it is known to half a bin (6%)."""
    return f"~{shown(float(f'{value:.2g}'))}" if value else "0"


def qualities_html(summary: Summary) -> str:
    """Return the distributions of grasp quality measures, which do not depend on the wrench; empty if none."""
    if not summary.qualities:
        return "<p class='note'>Not computed: add --quality to jaxgrasp evaluate.</p>"
    rows = []
    for name, quality in summary.qualities.items():
        values = quality.values
        quantiles = [about(number, values.quantile(q)) if values.total else NOTHING for q in (0.05, 0.5, 0.95)]
        closure = name == "force-closure"
        above = share(int(values.counts.sum()), values.total)
        rows.append(
            [
                text(name),
                f"{above} closed" if closure else above,
                *([NOTHING] * 4 if closure else [*quantiles, number(values.largest)]),
                format_count(quality.undecided) if quality.undecided else NOTHING,
            ]
        )
    head = ["measure", "above zero", "5%", "median", "95%", "largest", "not decided"]
    note = (
        "Of the grasps alone, whatever wrench they hold. Quantiles are to 6%; the largest is exact. Not decided: "
        f"grasps whose closure is not known, or whose bounds are more than {number(100 * APART)}% apart."
    )
    return table(head, rows) + f'<p class="note">{note}</p>'


def angles_html(summary: Summary) -> str:
    figure = figures.slip_maps(summary)
    if figure is None:
        return "<p class='note'>No contact carries a force in any answer.</p>"
    sampled = max(int(method.angles.sum()) for method in summary.methods.values())
    first = "" if unit(summary) == "grasp" else " under the first wrench"
    note = (
        "Slip angle: between a contact's force and its inward normal, 0° where it presses straight, above 90° where it "
        "pulls. A contact above the line slip = friction angle slips. "
        f"A sample of at most {counted(sampled, 'loaded contact')} of answers that balance the wrench{first}; the "
        "shares count cells that lie wholly above the line."
    )
    return f'<p class="note">{note}</p>{figure_html("angles", figure)}'


def times_html(summary: Summary, times: Times) -> str:
    """Return a table of time next to error, for a time alone says nothing."""
    rows = []
    for name, method in summary.methods.items():
        spent = times.solving.get(name, 0.0)
        time_each = spent / times.problems if times.problems else 0.0
        optimum = name.endswith("optimum")
        skipped = method.count(Verdict.CLOSED_FORM_OPTIMAL)
        solved = summary.problems - skipped
        rows.append(
            [
                f"{swatch(METHOD_COLOURS[name])}{method_title(name)}",
                seconds(time_each),
                seconds(spent),
                f"{format_count(skipped)} ({share(skipped, summary.problems)})" if optimum else NOTHING,
                number(method.steps / solved) if optimum and solved else NOTHING,
                number(method.largest_residual),
                degrees(method.smallest_margin),
            ]
        )
    head = [
        "method",
        f"time a {unit(summary)}",
        "in all",
        "no solve needed",
        "Newton steps a solve",
        "largest residual",
        "smallest friction margin",
    ]
    return table(head, rows) + _times_note(summary, times)


def _times_note(summary: Summary, times: Times) -> str:
    notes = [f"Compiling took {seconds(times.compiling)} more." if times.compiling else "Nothing had to be compiled."]
    if any(name.endswith("optimum") for name in times.solving):
        notes.append("An optimum's time includes the closed form that it starts from.")
        notes.append("No solve is needed where the closed form is already optimal.")
    if times.problems > summary.problems:
        padding = format_count(times.problems - summary.problems)
        notes.append(f"Timed on {format_count(times.problems)} problems, {padding} of them padding.")
    elif times.problems < summary.problems:
        notes.append(f"Timed on the {counted(times.problems, 'problem')} that this run solved.")
    notes.append(
        "Residual, of answers that balance the wrench: |G f \N{MINUS SIGN} w| over the forces and moments at work."
    )
    bad = counted(summary.set_aside, "grasp") if summary.set_aside else "none"
    notes.append(f"Set aside for faults in the data: {bad}.")
    return f'<p class="note">{" ".join(notes)}</p>'


def details_html(details: dict[str, str]) -> str:
    rows = "".join(f"<dt>{text(name)}</dt><dd>{text(value)}</dd>" for name, value in details.items())
    return f'<dl class="details">{rows}</dl>' if rows else "<p class='note'>None were given.</p>"
