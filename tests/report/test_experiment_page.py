"""The page of an experiment: it holds what was found, and nothing from outside unescaped."""

import itertools
import json
import re

import numpy as np
import pytest

from jaxgrasp.psychophysics.analysis.experiment import analyse, load_experiment
from jaxgrasp.psychophysics.analysis.finding import Finding
from jaxgrasp.psychophysics.person import SimulatedPerson
from jaxgrasp.psychophysics.plan import METHODS, Plan, SessionPlan
from jaxgrasp.psychophysics.procedures import ConstantStimuli
from jaxgrasp.psychophysics.psychometric import Observer
from jaxgrasp.psychophysics.session import run_experiment
from jaxgrasp.psychophysics.trial import IdealStimulus, PredictedStimulus, Rendered
from jaxgrasp.report.experiment_page import experiment_html

PLAN = Plan("a <b>plan</b>", session=SessionPlan((1.0, 2.0)))


def done(plan: Plan, folder, people: int = 3, stimulus=None):
    for k in range(people):
        person = SimulatedPerson(Observer(0.12), plan.seed, f"S{k}")
        run_experiment(plan, f"S{k}", folder, stimulus or IdealStimulus(), person)
    return analyse(load_experiment(folder))


def data_of(page: str) -> dict[str, dict]:
    data_blocks = re.findall(r'<script type="application/json" id="(.*?)-data">(.*?)</script>', page, re.S)
    return {name: json.loads(text) for name, text in data_blocks}


@pytest.mark.slow
def test_figures_show_what_was_found(folder):
    analysis = done(PLAN, folder)
    page = experiment_html(analysis)
    assert "a &lt;b&gt;plan" in page and "<b>plan" not in page
    figures = data_of(page)
    points = [trace for trace in figures["psychometric"]["data"] if trace["mode"] == "markers" and "error_y" in trace]
    for cell, shown in zip(analysis.pooled, points):
        # A little aside, so that intervals do not cover each other.
        near = 0.03 * max(cell.counts.levels)
        assert shown["x"] == pytest.approx(cell.counts.levels, abs=near)
        assert shown["y"] == pytest.approx(cell.counts.ratios)
    assert not set(points[0]["x"]) & set(points[1]["x"])
    assert figures["psychometric"]["layout"]["legend"]["y"] > 1, "the legend stands above the lines"
    for k, reference in enumerate(PLAN.session.references):
        shown = [trace for trace in figures[f"persons-{k}"]["data"] if "error_y" in trace]
        cells = [cell for cell in analysis.cells if cell.reference == reference]
        assert [trace["name"] for trace in shown] == [cell.subject for cell in cells]
        assert all(trace["y"] == pytest.approx(cell.counts.ratios) for trace, cell in zip(shown, cells))
        # As wide as a marker, on a figure of some 1,000 pixels: equal counts of several persons are all seen.
        apart = [np.subtract(b["x"], a["x"]) for a, b in itertools.pairwise(shown)]
        assert np.min(apart) > 0.008 * max(cells[0].counts.levels)
    jnds = figures["jnd"]["data"][0]
    assert jnds["y"] == pytest.approx([cell.weber.jnd for cell in analysis.pooled if cell.weber])
    assert analysis.comparison is None or "analysis of variance" in page


@pytest.mark.parametrize("method", ["staircase", "matching", "adaptive"])
def test_every_procedure_has_a_page(folder, method):
    plan = Plan(session=SessionPlan((2.0,)), method=method, procedure=METHODS[method]())
    analysis = done(plan, folder, 1)
    figures = data_of(experiment_html(analysis))
    assert ("staircases" in figures) == (method == "staircase") and ("psychometric" in figures) == (
        method != "matching"
    )
    if method == "staircase":
        assert len(figures["staircases"]["data"]) == 2 == len(analysis.traces)


def test_what_it_means_is_said_only_where_there_is_something_to_say(folder):
    def advice(page: str) -> list[str]:
        return re.findall(r'<span class="wide narrow">(.*?)</span>', page)

    analysis = done(Plan(session=SessionPlan((2.0,)), procedure=ConstantStimuli(repeats=40)), folder / "found", 1)
    assert {cell.threshold.finding for cell in (*analysis.pooled, *analysis.cells)} == {Finding.FOUND}
    page = experiment_html(analysis)
    assert "what it means" not in page and not advice(page)
    easy = Plan(session=SessionPlan((2.0,)), procedure=ConstantStimuli(levels=(5.0, 9.0)))
    analysis = done(easy, folder / "easy", 1)
    assert advice(experiment_html(analysis)) == [
        cell.threshold.finding.advice for cell in (*analysis.pooled, *analysis.cells)
    ]


@pytest.mark.slow
def test_nothing_found_is_said(folder):
    """All answers right, all trials cut, detection: still a page, and no number that nobody found."""
    plan = Plan(session=SessionPlan((2.0,)), procedure=ConstantStimuli(levels=(5.0, 9.0)))
    analysis = done(plan, folder / "easy", 1)
    assert np.isnan(analysis.pooled[0].threshold.value)
    assert "Every answer is right" in experiment_html(analysis)

    class Weak(PredictedStimulus):
        def predict(self, intensity):
            return Rendered(intensity, 1.0, 1.0, True)

    analysis = done(PLAN, folder / "weak", 1, Weak())
    page = experiment_html(analysis)
    assert (
        "A torque was cut in all 40 trials" in page and "0 to ∞" not in page and "No reference has a threshold" in page
    )
    assert all(cell.saturated == 40 for cell in analysis.pooled)
    detection = Plan(session=SessionPlan((0.0,)), procedure=ConstantStimuli(levels=(0.1, 0.2, 0.3)))
    person = SimulatedPerson(Observer(absolute=0.15), 1, "S1")
    run_experiment(detection, "S1", folder / "detection", IdealStimulus(), person)
    analysis = analyse(load_experiment(folder / "detection"))
    assert analysis.pooled[0].weber is None and "intensity [N]" in experiment_html(analysis)
