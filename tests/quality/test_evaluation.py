"""Measures of quality in evaluations: the functions' own numbers, in one go, in chunks and resumed."""

import json

import numpy as np
import pytest

import jaxgrasp
from jaxgrasp.batch.evaluation import evaluate
from jaxgrasp.batch.file_error import GraspFileError
from jaxgrasp.batch.shards import ResultFolder
from jaxgrasp.batch.sources import MemorySource
from jaxgrasp.batch.stream import StreamPlan, evaluate_stream
from jaxgrasp.batch.summary import from_json, to_json
from jaxgrasp.batch.summary_text import summary_text
from jaxgrasp.cli.main import main
from jaxgrasp.quality import ferrari_canny, force_closure, grasp_volume, min_weight
from jaxgrasp.quality.measures import CLOSED, MEASURES, measures_named
from tests.batch.conftest import make_sets

SIZES = [3, 5, 2, 4, 5, 3]
SOME = ("min-weight", "force-closure")


@pytest.fixture(scope="module")
def sets():
    return make_sets(SIZES)


def test_every_measure_is_its_functions(sets):
    columns = evaluate(sets, methods=("B",), quality=tuple(MEASURES)).quality
    for index in range(len(SIZES)):
        grasp = sets.grasp(index)
        closure, ball = force_closure(grasp), ferrari_canny(grasp, "linf")
        assert (columns["force-closure.closed"][index] == CLOSED) == closure.closed
        np.testing.assert_allclose(columns["force-closure.margin"][index], closure.margin, rtol=1e-6, atol=1e-15)
        assert columns["ferrari-canny-linf.lower"][index] <= ball.upper
        np.testing.assert_allclose(columns["ferrari-canny-linf.upper"][index], ball.upper, rtol=1e-6, atol=1e-15)
        np.testing.assert_allclose(columns["min-weight.value"][index], min_weight(grasp).value, rtol=1e-8)
        volume = grasp_volume(grasp)
        np.testing.assert_allclose(columns["volume.value"][index], volume, rtol=1e-9, atol=1e-12)


def test_nothing_is_computed_or_written_that_was_not_asked_for(sets, folder):
    plain = evaluate(sets, methods=("B",))
    assert plain.quality == {} and plain.summary.qualities == {}
    out = ResultFolder(folder / "out", StreamPlan(("B",)).identity("x", MemorySource(sets)), False)
    evaluate_stream(MemorySource(sets), StreamPlan(("B",)), out)
    assert not any(name.startswith("quality") for name in np.load(folder / "out" / "results.npz"))


def test_chunks_and_a_resumed_run_give_the_same_columns(sets, folder):
    source, plan = MemorySource(sets), StreamPlan(("B",), chunk=2, quality=SOME)
    evaluation = evaluate(sets, methods=("B",), quality=SOME)

    class Stop(Exception):
        pass

    def stop(_):
        raise Stop

    with pytest.raises(Stop):
        evaluate_stream(source, plan, ResultFolder(folder, plan.identity("x", source), False), stop)
    other_plan = StreamPlan(("B",), chunk=2, quality=("volume",))
    with pytest.raises(GraspFileError, match="its results have quality = .*min-weight"):
        ResultFolder(folder, other_plan.identity("x", source), True)
    again = ResultFolder(folder, plan.identity("x", source), True)
    assert again.done == 2
    outcome = evaluate_stream(source, plan, again)
    written = np.load(folder / "results.npz")
    for name, column in evaluation.quality.items():
        np.testing.assert_allclose(written[f"quality.{name}"], column, rtol=1e-9, atol=1e-12)
    reread = from_json(json.loads(json.dumps(to_json(evaluation.summary)))).qualities
    for name, quality in outcome.summary.qualities.items():
        np.testing.assert_array_equal(quality.values.counts, reread[name].values.counts)
        assert quality.values.total == len(SIZES) and quality.undecided == reread[name].undecided == 0
    text = summary_text(outcome.summary, outcome.times, 1.0)
    share = 100 * np.mean(evaluation.quality["force-closure.closed"] == CLOSED)
    assert f"force-closure         {share:.1f} % closed" in text and "min-weight" in text


def test_names_are_taken_once_in_the_tables_order_and_unknown_ones_refused():
    assert [m.name for m in measures_named(("volume", "force-closure", "volume"))] == ["force-closure", "volume"]
    with pytest.raises(
        ValueError, match="quality 'epsilon' is unknown: expected one or more of force-closure, ferrari"
    ):
        measures_named(("epsilon",))


def test_the_command_line_takes_names_with_commas_and_refuses_unknown_ones(folder, sets, capsys):
    jaxgrasp.save_grasps(folder / "grasps.npz", sets)
    common = ["evaluate", "grasps.npz", "--methods", "B", "--no-report"]
    assert main([*common, "--quality", "volume,nonsense"]) == 1
    assert "quality 'nonsense' is unknown: expected one or more of" in capsys.readouterr().err
    assert not (folder / "jaxgrasp-results").exists()
    assert main([*common, "--quality", "volume, isotropy"]) == 0
    shown = capsys.readouterr().out
    assert "volume" in shown and "isotropy" in shown
    written = np.load(folder / "jaxgrasp-results" / "results.npz")
    assert written["quality.isotropy.value"].shape == (len(SIZES),)
