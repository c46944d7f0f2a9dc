"""The parts of the page below the headline: each figure with the sentences that define what it shows."""

from collections.abc import Callable

from jaxgrasp.batch.chunk_statistics import LogHistogram
from jaxgrasp.batch.engine import Times
from jaxgrasp.batch.qualities import APART
from jaxgrasp.batch.summary import Summary
from jaxgrasp.model.solution import Verdict
from jaxgrasp.report import figures
from jaxgrasp.report.bundle import embedded
from jaxgrasp.report.headline import unit
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
    swatch,
    table,
    text,
)

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
