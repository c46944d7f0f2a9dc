"""``jaxgrasp experiment analyse``, ``export`` and ``paper``: thresholds, tidy tables, and the paper's numbers."""

import json
import math
from collections import Counter
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from jaxgrasp.cli.experiment_arguments import Analyse, Export, HowAnalysed, Paper
from jaxgrasp.cli.terminal import show
from jaxgrasp.files.csv_rows import write_rows
from jaxgrasp.files.replace import check_writable, replace_file
from jaxgrasp.psychophysics.analysis.cell import AnalysisSettings, Cell, suited_criterion, suited_lapse, suited_shape
from jaxgrasp.psychophysics.analysis.experiment import Analysis, Answers, analyse, load_experiment
from jaxgrasp.psychophysics.analysis.finding import Finding
from jaxgrasp.psychophysics.analysis.likelihood import Model
from jaxgrasp.psychophysics.analysis.tidy import tidy_tables
from jaxgrasp.psychophysics.plan import Plan
from jaxgrasp.psychophysics.psychometric import PsychometricShape
from jaxgrasp.psychophysics.recomputed import recomputed
from jaxgrasp.psychophysics.session import EVERYONE


def analyse_command(arguments: Analyse) -> int:
    """Read, analyse, say, write."""
    analysis = analysed(arguments)[1]
    show("\n".join(analysis_lines(analysis)))
    out = arguments.folder if arguments.out is None else arguments.out
    out.mkdir(parents=True, exist_ok=True)
    content = json.dumps(_plain(asdict(analysis)), indent=1, allow_nan=False).encode()
    replace_file(out / "analysis.json", lambda stream: stream.write(content + b"\n"))
    show(f"written: {out / 'analysis.json'}")
    if arguments.report:
        _report(out / "report.html", analysis)
    return 0


def analysed(arguments: HowAnalysed) -> tuple[Answers, Analysis]:
    """Load the answers of a folder and analyse them; return both."""
    if arguments.lapse is not None and not 0 <= arguments.lapse < 0.5:
        raise ValueError(f"lapse is {arguments.lapse}: expected 0 or more, and less than 0.5")
    answers = load_experiment(arguments.folder)
    settings = AnalysisSettings(
        arguments.method, _model(arguments, answers.plan), arguments.interval, saturated=arguments.saturated
    )
    return answers, analyse(answers, settings)


def _model(arguments: HowAnalysed, plan: Plan) -> Model:
    """Return the psychometric model of the arguments, else the plan's; methods that fit lines have no lapses."""
    shape = arguments.shape or suited_shape(plan)
    lapse = suited_lapse(plan) if arguments.lapse is None else arguments.lapse
    most = lapse if arguments.method in ("likelihood", "posterior") else 0.0
    criterion = suited_criterion(plan) if arguments.criterion is None else arguments.criterion
    return Model(PsychometricShape(shape), criterion, 0.5, (0.0, most))


def analysis_lines(analysis: Analysis) -> list[str]:
    """Format thresholds, means over persons, matches, differences and notes as lines of text."""
    settings = analysis.settings
    unit = analysis.plan.stimulus.unit
    lines = [f"{analysis.plan.name}: {len(analysis.subjects)} person(s), {analysis.plan.method}"]
    status, opposite = ("left out", "counted") if settings.saturated == "exclude" else ("counted", "left out")
    for cell in (*analysis.pooled, *analysis.cells):
        lines.append(f"{cell.subject:>8} at {cell.reference:g} {unit}: {_threshold(cell, unit, opposite)}")
    for group in analysis.groups:
        lines.append(
            f"{'persons':>8} at {group.reference:g} {unit}: mean {_number(group.mean)}, deviation "
            f"{_number(group.deviation)}, standard error {_number(group.error)}, "
            f"of the {group.persons} of {group.n_persons} who have a threshold"
        )
    for match in analysis.matched:
        lines.append(
            f"{match.subject:>8} at {match.reference:g} {unit}: {match.settings} settings, "
            f"error {match.error:+.3g} {unit} ({match.error_low:+.3g} to {match.error_high:+.3g}), "
            f"deviation {match.deviation:.3g} {unit} ({match.deviation_low:.3g} to {match.deviation_high:.3g}), "
            f"JND {match.jnd:.3g} {unit}"
        )
    lines += within_lines(analysis) + _differences(analysis, unit)
    lines += [f"note: {note}" for note in analysis.notes]
    if any(cell.saturated for cell in analysis.pooled) or any(match.saturated for match in analysis.matched):
        lines.append(f"trials in which a torque was cut are {status}; --saturated changes that")
    return lines


def _threshold(cell: Cell, unit: str, word: str) -> str:
    threshold = cell.threshold
    bounds = f"{100 * threshold.coverage:g}% interval {_number(threshold.low)} to {_number(threshold.high)}"
    if threshold.finding is Finding.NO_TRIALS:
        text = f"no threshold: {cell.remark}"
    elif not threshold.finding.has_threshold:
        text = f"no threshold ({threshold.finding}); {bounds}. {cell.remark}"
    elif cell.weber is not None:
        text = f"Weber fraction {threshold.value:.3f}, JND {cell.weber.jnd:.3g} {unit}; {bounds}"
    else:
        text = f"threshold {threshold.value:.3g} {unit}; {bounds}"
    if threshold.finding.has_threshold and cell.remark:
        text += f" ({threshold.finding}). {cell.remark.rstrip('.')}"
    if cell.fit is not None and cell.fit.p_value < 0.05:
        text += f"; the function does not fit (p = {cell.fit.p_value:.3f})"
    if cell.alternative is not None:
        alternative = cell.alternative
        text += f"; {cell.saturated} saturated trials {word} it would be "
        text += f"{alternative.value:.3f}" if alternative.finding.has_threshold else f"none ({alternative.finding})"
    return text


def _differences(analysis: Analysis, unit: str) -> list[str]:
    lines = []
    if (line := analysis.line) is not None:
        lines.append(
            f"JND of {EVERYONE}: limit {line.limit:.3f} \N{PLUS-MINUS SIGN} {line.limit_deviation:.3f} x "
            f"reference, floor {line.floor:+.3g} \N{PLUS-MINUS SIGN} {line.floor_deviation:.2g} {unit}"
        )
    if analysis.comparison is not None:
        within, between = analysis.comparison.within, analysis.comparison.between
        lines.append(
            f"between references, {len(analysis.comparison.subjects)} of {len(analysis.subjects)} persons: "
            f"repeated measures F[{within.between:g}, {within.within:g}] = {within.f:.2f}, "
            f"p = {within.p_value:.4f} ({within.corrected_p_value:.4f} corrected, epsilon {within.sphericity:.2f}), "
            f"partial eta squared {within.eta_squared:.2f}; as if of different persons "
            f"F[{between.between:g}, {between.within:g}] = {between.f:.2f}, p = {between.p_value:.4f}"
        )
        for pair in analysis.comparison.pairs:
            first, second = (analysis.comparison.references[k] for k in pair.groups)
            lines.append(
                f"  {first:g} less {second:g} {unit}: {pair.difference:+.3f}, p = {pair.p_value:.4f} (Holm), "
                f"d_z = {pair.effect:.2f}"
            )
    return lines


def within_lines(analysis: Analysis) -> list[str]:
    """Format the comparison of conditions within persons as lines; none where there is none."""
    within = analysis.within
    if within is None:
        return []
    lines = [
        f"{within.factor} {condition}: right answers {100 * mean:.1f} %, deviation {100 * deviation:.1f} %"
        for condition, mean, deviation in zip(within.conditions, within.means, within.deviations, strict=True)
    ]
    anova = within.anova
    lines.append(
        f"between conditions of {within.factor}, {len(within.subjects)} persons: repeated measures "
        f"F[{anova.between:g}, {anova.within:g}] = {anova.f:.2f}, p = {anova.p_value:.4f} "
        f"({anova.corrected_p_value:.4f} corrected, epsilon {anova.sphericity:.2f}), partial eta squared "
        f"{anova.eta_squared:.2f}"
    )
    for pair in within.pairs:
        first, second = (within.conditions[k] for k in pair.groups)
        lines.append(
            f"  {first} less {second}: {100 * pair.difference:+.1f} %, p = {pair.p_value:.4f} (Holm), "
            f"d_z = {pair.effect:.2f}"
        )
    return lines


def _number(value: float) -> str:
    if math.isnan(value):
        return "none"
    return f"{value:.3g}" if math.isfinite(value) else "without bound"


def _report(path: Path, analysis: Analysis) -> None:
    from jaxgrasp.report.experiment_page import write_experiment_page

    try:
        write_experiment_page(path, analysis)
        show(f"report:  {path}")
    except ImportError as error:
        show(f"no report: {error}")


def _plain(value: Any) -> Any:
    """Convert a value to JSON types: arrays to lists, and numbers that are not finite to None."""
    if isinstance(value, dict):
        return {str(key): _plain(element) for key, element in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(element) for element in value]
    if isinstance(value, np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, np.generic):
        return _plain(value.item())
    return value if not isinstance(value, float) or math.isfinite(value) else None


def export_command(arguments: Export) -> int:
    """Read, analyse, write."""
    out = arguments.folder / "export" if arguments.out is None else arguments.out
    check_writable(out)
    tables = tidy_tables(*analysed(arguments))
    out.mkdir(parents=True, exist_ok=True)
    for name, rows in tables.items():
        write_rows(out / name, rows)
        show(f"written: {out / name}, {len(rows) - 1} rows")
    return 0


def paper_command(command: Paper) -> int:
    """Print the table of printed and recomputed numbers, notes on its rows, and a count of the outcomes."""
    rows = recomputed()
    widths = [max(len(getattr(row, name)) for row in rows) for name in ("quantity", "printed", "recomputed")]
    head = ("quantity", "printed", "recomputed (range by rounding)")
    show("  ".join(f"{text:{width}}" for text, width in zip(head, widths, strict=True)) + "  outcome")
    for row in rows:
        cells = (row.quantity, row.printed, row.recomputed)
        show("  ".join(f"{text:{width}}" for text, width in zip(cells, widths, strict=True)) + f"  {row.outcome}")
        if row.note:
            show(f"    {row.note}")
    counts = Counter(row.outcome for row in rows)
    show("; ".join(f"{counts[outcome]} {outcome}" for outcome in dict.fromkeys(row.outcome for row in rows)))
    return 0
