"""Measures of a task in evaluations: the functions' own numbers, files of demands, ranking, and ending halfway."""

import json
from threading import get_ident

import numpy as np
import pytest

import jaxgrasp
from jaxgrasp import Limits
from jaxgrasp.batch import qualities
from jaxgrasp.batch.contact_sets import ContactSets
from jaxgrasp.batch.evaluation import evaluate
from jaxgrasp.batch.shards import ResultFolder
from jaxgrasp.batch.sources import MemorySource
from jaxgrasp.batch.stream import StreamPlan, evaluate_stream
from jaxgrasp.cli.main import main
from jaxgrasp.quality import TaskDemands, ferrari_canny, hold_probability, load_demands, task_margin
from jaxgrasp.quality.measures import TASK_MEASURES, measures_named
from jaxgrasp.testing.limited_problems import limited_problems

COUNT, N = 5, 3
TASK = """
wrenches = [[0.0, 0, 1, 0, 0, 0], [1, 0, 0, 0, 0, 0.01]]
semi_axes = [1, 1, 2, 0.03, 0.03, 0.03]

[uncertainty]
friction = 0.1
place = 0.001
samples = 64
"""


@pytest.fixture(scope="module")
def made():
    return limited_problems("ordinary", N, COUNT, 6, bounded=True)


@pytest.fixture(scope="module")
def sets(made):
    return ContactSets.from_grasp(made.grasp, made.problem.wrench, made.limits)


@pytest.fixture
def demands(folder) -> TaskDemands:
    (folder / "task.toml").write_text(TASK)
    return load_demands(folder / "task.toml")


@pytest.mark.slow
def test_every_measure_of_a_task_is_its_functions(made, sets, demands):
    columns = evaluate(sets, methods=("B",), quality=tuple(TASK_MEASURES), task=demands).quality
    grasp, limits = made.grasp, made.limits
    for bound in ("l1", "linf"):
        ball = ferrari_canny(grasp, bound, ellipsoid=demands.ellipsoid)
        np.testing.assert_allclose(columns[f"task-ball-{bound}.upper"], ball.upper, rtol=1e-6, atol=1e-12)
    tasks = np.array(demands.wrenches) + np.zeros((COUNT, 1, 1))
    tasks[..., 3:] += np.cross(grasp.points.mean(1)[:, None], tasks[..., :3])
    margin = task_margin(grasp, tasks, sharing="uniform", limits=limits)
    np.testing.assert_allclose(columns["task-margin.margin"], margin.margin, rtol=1e-7, atol=1e-9)
    np.testing.assert_array_equal(columns["task-margin.weakest"], margin.weakest)
    held = hold_probability(
        grasp, made.problem.wrench, "uniform", limits=limits, friction_spread=0.1, place_spread=0.001, samples=64
    )
    for name in ("probability", "low", "high", "margin"):
        np.testing.assert_allclose(columns[f"hold-probability.{name}"], getattr(held, name), rtol=1e-6, atol=1e-9)


def test_measures_of_a_task_need_their_demands():
    with pytest.raises(
        ValueError, match="quality 'task-margin' needs the demands of a task: expected a task file with wrenches"
    ):
        measures_named(("task-margin",))
    with pytest.raises(
        ValueError, match=r"'hold-probability' needs the demands of a task: expected .* with a table \[uncertainty\]"
    ):
        measures_named(("hold-probability",), TaskDemands(wrenches=((0.0,) * 6,)))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("wrenches = [[0, 0, 1]]", r"task.toml: wrenches\[0\] is \[0.0, 0.0, 1.0\]: expected six finite numbers"),
        ("wrenches = []", "task.toml: wrenches is empty: expected one or more"),
        ("semi_axes = [1, 1, 1, 1, 1, 0]", r"semi_axes\[5\] is 0.0: expected a positive number"),
        ("axes = [[1, 0, 0, 0, 0, 0]]", "axes has 1 rows: expected six that span all wrenches"),
        ("wrench = [1]", "task.toml has 'wrench': did you mean 'wrenches'?"),
        ("[uncertainty]\nfriction = -1", "uncertainty: friction is -1.0: expected a finite number, 0 or more"),
        ("[uncertainty]\nsamples = 0", "uncertainty: samples is 0: expected a number of cases, 1 or more"),
        ("about = 'world'", "task.toml.about is 'world': expected one of contacts, origin"),
        ("about = ", "task.toml is no TOML"),
    ],
)
def test_a_file_that_cannot_be_used_is_refused_before_any_work(folder, sets, capsys, text, message):
    jaxgrasp.save_grasps(folder / "grasps.npz", sets)
    (folder / "task.toml").write_text(text)
    with pytest.raises(ValueError, match=message):
        load_demands("task.toml")
    assert main(["evaluate", "grasps.npz", "--quality", "task-margin", "--task", "task.toml"]) == 1
    assert len(capsys.readouterr().err.strip().splitlines()) == 1
    assert not (folder / "jaxgrasp-results").exists()


@pytest.mark.slow
def test_the_command_line_writes_columns_that_rank_sorts_by(folder, sets, demands, capsys):
    jaxgrasp.save_grasps(folder / "grasps.npz", sets)
    common = ["evaluate", "grasps.npz", "--methods", "B-optimum", "--no-report", "--task", "task.toml"]
    assert main([*common, "--quality", "task-margin,hold-probability"]) == 0
    assert "task-margin" in capsys.readouterr().out
    written = np.load(folder / "jaxgrasp-results" / "results.npz")
    best = written["quality.task-margin.margin"].argmax()
    assert main(["rank", "jaxgrasp-results", "--by", "task-margin"]) == 0
    first = capsys.readouterr().out.splitlines()[1].split()
    assert first[0] == str(best)
    manifest = json.loads((folder / "jaxgrasp-results" / "manifest.json").read_text())
    assert "semi_axes" in json.dumps(manifest)
    (folder / "task.toml").write_text(TASK.replace("0.01", "0.02"))
    assert main([*common, "--quality", "task-margin,hold-probability", "--resume"]) == 1
    assert "task" in capsys.readouterr().err


def test_what_ends_an_evaluation_ends_its_chunks_at_work_and_keeps_the_finished_ones(folder, sets, monkeypatch):
    monkeypatch.setattr(qualities, "TOGETHER", 1)
    many = sets.rows(np.tile(np.arange(COUNT), 8))
    source, plan = MemorySource(many), StreamPlan(("B",), chunk=COUNT, quality=("volume",))
    counts: list[int] = []

    def stop(_):
        raise KeyboardInterrupt

    out = ResultFolder(folder / "out", plan.identity("x", source), False)
    with pytest.raises(KeyboardInterrupt):
        evaluate_stream(source, plan, out, stop, measured=lambda grasps: counts.append(get_ident()))
    assert get_ident() not in counts
    assert COUNT <= len(counts) < len(many) - COUNT, "one chunk is done, and no more than those at work were begun"
    again = ResultFolder(folder / "out", plan.identity("x", source), True)
    assert again.done == COUNT and not list((folder / "out").glob("*.tmp*"))
    outcome = evaluate_stream(source, plan, again, measured=lambda grasps: None)
    assert outcome.resumed == COUNT


@pytest.mark.slow
def test_limits_of_the_hand_are_those_of_the_file(sets, demands, made):
    wide = Limits(normal_max=np.full((COUNT, N), 1e3))
    free = ContactSets.from_grasp(made.grasp, made.problem.wrench, wide)
    margins = [
        evaluate(some_sets, methods=("B",), quality=("task-margin",), task=demands).quality["task-margin.margin"]
        for some_sets in (sets, free)
    ]
    assert (margins[1] > margins[0] - 1e-7).all() and (margins[1] > margins[0] + 1e-3).any()
