"""Evaluations: equal to the single answers, whatever the order, padding, chunk, device or interruption."""

import copy
import dataclasses
import json
import os
import time
from threading import Event

import jax
import numpy as np
import pytest

import jaxgrasp
from jaxgrasp.batch import engine, stream
from jaxgrasp.batch.evaluation import evaluate
from jaxgrasp.batch.file_error import GraspFileError
from jaxgrasp.batch.shards import ResultFolder
from jaxgrasp.batch.sources import MemorySource
from jaxgrasp.batch.stream import StreamPlan, evaluate_stream
from jaxgrasp.batch.summary import from_json, to_json
from jaxgrasp.batch.summary_text import summary_text
from jaxgrasp.model.solution import Verdict
from tests.batch.conftest import make_sets

SIZES = [3, 5, 4, 2, 5, 3, 4, 5]


@pytest.fixture(scope="module")
def sets():
    return make_sets(SIZES * 5, wrenches=2)


@pytest.fixture(scope="module")
def evaluation(sets):
    return evaluate(sets)


@pytest.mark.parametrize(
    ("method", "function", "sharing"),
    [
        pytest.param("A", "closed_form", "uniform", marks=pytest.mark.slow),
        ("B", "closed_form", "squeeze"),
        pytest.param("A-optimum", "constrained_optimum", "uniform", marks=pytest.mark.slow),
        ("B-optimum", "constrained_optimum", "squeeze"),
    ],
)
def test_equals_the_single_answers(sets, evaluation, method, function, sharing):
    result = evaluation.results[method]
    grasp = jax.tree.map(lambda x: x[:, None], sets.padded(6))
    alone = getattr(jaxgrasp, function)(grasp, sets.wrench, sharing)
    np.testing.assert_array_equal(result.verdict, alone.verdict)
    is_present = np.arange(6) < sets.sizes[:, None]
    forces = np.swapaxes(np.asarray(alone.forces), 1, 2)[is_present]
    np.testing.assert_allclose(result.forces, forces, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(result.objective, alone.objective, rtol=1e-9, atol=1e-12)


def test_margins_and_violations_agree_with_the_angles(sets, evaluation):
    for result in evaluation.results.values():
        beyond = result.violation > 1e-9
        np.testing.assert_array_equal(beyond, result.margin < -1e-9)


def test_a_closed_form_costs_no_more_than_its_optimum(evaluation):
    for name in ("A", "B"):
        closed, best = evaluation.results[name], evaluation.results[f"{name}-optimum"]
        solved = best.verdict <= Verdict.OPTIMAL
        assert solved.any()
        assert np.all(closed.objective[solved] <= best.objective[solved] * (1 + 1e-9) + 1e-12)


def test_order_does_not_matter(sets, evaluation):
    order = np.random.default_rng(1).permutation(len(sets))
    shuffled = evaluate(sets.rows(order))
    np.testing.assert_allclose(
        shuffled.results["B-optimum"].objective, evaluation.results["B-optimum"].objective[order], rtol=1e-9, atol=1e-12
    )


@pytest.mark.slow
def test_shapes_of_their_own_change_nothing(sets, evaluation, monkeypatch):
    monkeypatch.setattr(engine, "WORTH_A_SHAPE", 1)
    assert len(set(engine.widths(sets.sizes, 2))) == 3
    apart = evaluate(sets, methods=("B",))
    np.testing.assert_allclose(apart.results["B"].forces, evaluation.results["B"].forces, rtol=1e-9, atol=1e-9)


def test_only_what_is_asked_for_is_computed(sets):
    some = evaluate(sets, methods=("B",))
    assert set(some.results) == {"B"} and not some.summary.comparisons
    with pytest.raises(ValueError, match="method 'C' is unknown: expected one or more of A, B"):
        evaluate(sets, methods=("C",))
    with pytest.raises(ValueError, match="methods is empty"):
        evaluate(sets, methods=())


def test_a_batch_of_grasps_is_taken_as_it_is():
    sets = make_sets([5] * 4)
    result = evaluate(sets.padded(5), sets.wrench[:, 0], methods=("B",)).results["B"]
    assert result.forces.shape == (20, 1, 3)
    with pytest.raises(ValueError, match="wrenches is None"):
        evaluate(sets.padded(5))


def test_float64_needs_its_mode(sets):
    with jax.enable_x64(False), pytest.raises(ValueError, match="64-bit mode is off"):
        evaluate(sets)
    single = evaluate(sets, methods=("B",), dtype="float32")
    assert single.results["B"].forces.dtype == np.float32


@pytest.mark.slow
def test_a_bad_grasp_stops_or_is_set_aside(sets, evaluation):
    friction = sets.friction.copy()
    friction[sets.offsets[7]] = np.nan
    spoiled = dataclasses.replace(sets, friction=friction)
    with pytest.raises(jaxgrasp.GraspError, match=r"friction\[7, 0\]"):
        evaluate(spoiled)
    remaining = evaluate(spoiled, skip_bad=True)
    assert remaining.summary.set_aside == 1 and len(remaining.sets) == len(sets) - 1
    is_usable = np.arange(len(sets)) != 7
    np.testing.assert_allclose(
        remaining.results["B"].objective, evaluation.results["B"].objective[is_usable], rtol=1e-9, atol=1e-12
    )


def read_results(folder):
    manifest = json.loads((folder / "manifest.json").read_text())
    return manifest, [np.load(folder / entry["file"], allow_pickle=False) for entry in manifest["shards"]]


def plan(**changes) -> StreamPlan:
    return StreamPlan(chunk=16, **changes)


def streamed(sets, folder, resume=False, overwrite=False, **changes):
    stream_plan = plan(**changes)
    out = ResultFolder(folder, stream_plan.identity("sets", MemorySource(sets)), resume, overwrite)
    return evaluate_stream(MemorySource(sets), stream_plan, out)


@pytest.mark.parametrize("workers", [1, 2, 5])
def test_results_keep_their_order_whoever_finishes_first(workers, monkeypatch):
    def slow_for_even(start, raw):
        time.sleep(0.02 * (start % 2 == 0))
        return start

    done = stream._in_order(slow_for_even, ((number, None) for number in range(9)), workers, Event())
    assert list(done) == list(range(9))


def test_a_fault_in_one_thread_is_raised_and_the_rest_left_undone():
    starts = []

    def fails_at_third(start, raw):
        starts.append(start)
        if start == 2:
            raise ValueError("no")
        return start

    with pytest.raises(ValueError, match="no"):
        list(stream._in_order(fails_at_third, ((number, None) for number in range(50)), 2, Event()))
    assert max(starts) < 10


def assert_same_summary(a, b):
    a, b = copy.deepcopy(to_json(a)), copy.deepcopy(to_json(b))
    for case in a["worst"] + b["worst"]:
        for name in ("closed", "optimum", "price", "margin", "violation"):
            case.pop(name)
    for methods in (a["methods"], b["methods"]):
        for method in methods.values():
            method.pop("largest_residual"), method.pop("smallest_margin")
    for comparisons in (a["comparisons"], b["comparisons"]):
        for comparison in comparisons.values():
            for name in ("price", "distance", "violation"):
                comparison[name].pop("largest")
    assert a == b


@pytest.mark.slow
def test_a_stream_says_what_the_whole_says(sets, evaluation, tmp_path):
    outcome = streamed(sets, tmp_path)
    assert_same_summary(outcome.summary, evaluation.summary)
    manifest, (results,) = read_results(tmp_path)
    assert manifest["complete"] and manifest["shards"][0]["file"] == "results.npz"
    np.testing.assert_array_equal(results["grasp"], np.arange(len(sets)))
    np.testing.assert_array_equal(results["offsets"], sets.offsets)
    np.testing.assert_allclose(
        results["B-optimum.forces"], evaluation.results["B-optimum"].forces, rtol=1e-9, atol=1e-9
    )
    assert sorted(os.listdir(tmp_path)) == ["manifest.json", "results.npz"]


class Interrupted(MemorySource):
    """A source that fails in its third chunk, after the check that reads all of it once."""

    passes = 0

    def chunks(self, size, start=0):
        self.passes += 1
        for number, part in enumerate(super().chunks(size, start)):
            if self.passes == 2 and number == 2:
                raise KeyboardInterrupt
            yield part


@pytest.mark.slow
def test_an_interrupted_stream_goes_on(sets, evaluation, tmp_path, monkeypatch):
    # With more at a time, none of these few chunks would be done by then.
    monkeypatch.setattr(stream, "_workers", lambda engine: 1)
    stream_plan = plan()
    identity = stream_plan.identity("sets", MemorySource(sets))
    with pytest.raises(KeyboardInterrupt):
        evaluate_stream(Interrupted(sets), stream_plan, ResultFolder(tmp_path, identity, resume=False))
    manifest, _ = read_results(tmp_path)
    assert not manifest["complete"] and len(manifest["shards"]) == 1
    for name in (".shard-00009.npz.1.partial", ".shard-00009.npz.00a9bfc926dc0347.partial"):
        (tmp_path / name).write_bytes(b"half")
    with pytest.raises(GraspFileError, match="--resume goes on"):
        ResultFolder(tmp_path, identity, resume=False)
    with pytest.raises(GraspFileError, match="dtype = 'float64', not 'float32'"):
        streamed(sets, tmp_path, resume=True, dtype="float32")
    outcome = streamed(sets, tmp_path, resume=True)
    assert outcome.resumed == 16
    assert_same_summary(outcome.summary, evaluation.summary)
    _, (results,) = read_results(tmp_path)
    np.testing.assert_array_equal(results["grasp"], np.arange(len(sets)))
    assert sorted(os.listdir(tmp_path)) == ["manifest.json", "results.npz"]


def test_another_finished_evaluation_gives_way_only_to_overwrite(sets, tmp_path):
    (tmp_path / "mine.txt").write_text("keep")
    streamed(sets, tmp_path, methods=("B",))
    before = (tmp_path / "results.npz").read_bytes()
    with pytest.raises(GraspFileError, match=r"methods = \['B'\], not \['A'\]: .* --overwrite"):
        streamed(sets, tmp_path, methods=("A",))
    assert (tmp_path / "results.npz").read_bytes() == before
    changed_sets = dataclasses.replace(sets, squeeze=2 * sets.squeeze)
    with pytest.raises(GraspFileError, match="sets has changed since these results were written: add --overwrite, or"):
        streamed(changed_sets, tmp_path, methods=("B",))
    renamed = dataclasses.replace(sets, labels={"name": np.array([f"g{k}" for k in range(len(sets))])})
    with pytest.raises(GraspFileError, match="sets has changed since"):
        streamed(renamed, tmp_path, methods=("B",))
    with pytest.raises(GraspFileError, match="its results are of 'sets', not of 'others': add --overwrite, or"):
        ResultFolder(tmp_path, plan(methods=("B",)).identity("others", MemorySource(sets)), resume=False)
    streamed(sets, tmp_path, methods=("B",))  # the same again loses nothing
    streamed(sets, tmp_path, overwrite=True, methods=("A",))
    _, (results,) = read_results(tmp_path)
    assert "A.forces" in results and "B.forces" not in results
    assert (tmp_path / "mine.txt").read_text() == "keep"


@pytest.fixture
def half(sets, tmp_path, monkeypatch):
    """Write the first two of three chunks of an evaluation; return their folder."""
    monkeypatch.setattr(stream, "_workers", lambda engine: 1)

    class Later(MemorySource):
        passes = 0

        def chunks(self, size, start=0):
            self.passes += 1
            parts = [*super().chunks(size, start)]
            yield from parts
            if self.passes == 2:
                raise KeyboardInterrupt

    stream_plan = plan(methods=("B",))
    folder = ResultFolder(tmp_path, stream_plan.identity("sets", MemorySource(sets)), resume=False)
    with pytest.raises(KeyboardInterrupt):
        evaluate_stream(Later(sets), stream_plan, folder)
    manifest, _ = read_results(tmp_path)
    assert len(manifest["shards"]) == 2
    return tmp_path


def cut_short(path):
    path.write_bytes(path.read_bytes()[:-200])


def one_bit(path):
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(bytes(content))


def of_another(path):
    path.write_bytes((path.parent / "shard-00001.npz").read_bytes())


def with_fewer_forces(path):
    arrays = dict(np.load(path))
    np.savez(path, **(arrays | {"B.forces": arrays["B.forces"][:5]}))


def never_ending(path):
    path.unlink()
    os.mkfifo(path)


@pytest.mark.parametrize(
    "harm", [cut_short, one_bit, of_another, with_fewer_forces, never_ending, lambda path: path.unlink()]
)
def test_damaged_shards_are_computed_again_before_anything_else_and_said(sets, half, harm):
    harm(half / "shard-00000.npz")
    stream_plan, messages = plan(methods=("B",)), []
    folder = ResultFolder(half, stream_plan.identity("sets", MemorySource(sets)), resume=True)
    outcome = evaluate_stream(MemorySource(sets), stream_plan, folder, announce=messages.append)
    assert sum("shard-00000.npz is missing or damaged" in text for text in messages) == 1
    assert outcome.resumed == 32 and outcome.summary.grasps == len(sets)
    _, (results,) = read_results(half)
    np.testing.assert_array_equal(results["grasp"], np.arange(len(sets)))
    evaluation = jaxgrasp.evaluate(sets, methods=("B",))
    np.testing.assert_array_equal(results["B.verdict"], evaluation.results["B"].verdict)
    np.testing.assert_allclose(results["B.forces"], evaluation.results["B"].forces, rtol=1e-9, atol=1e-9)


def test_a_finished_evaluation_whose_file_is_damaged_is_done_again(sets, tmp_path):
    streamed(sets, tmp_path, methods=("B",))
    cut_short(tmp_path / "results.npz")
    outcome = streamed(sets, tmp_path, resume=True, methods=("B",))
    assert outcome.resumed == 0
    _, (results,) = read_results(tmp_path)
    assert len(results["grasp"]) == len(sets)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda m: m | {"summary": {"junk": 1}}, "was changed after"),
        (lambda m: m | {"summary": None}, "was changed after"),
        (lambda m: m | {"shards": []}, "was changed after"),
        (lambda m: m | {"shards": {}}, "was changed after"),
        (lambda m: m | {"complete": True}, "was changed after"),
        (lambda m: m | {"shards": [m["shards"][0] | {"stop": 1e999}]}, "was changed after"),
        (lambda m: m | {"version": 1}, "its results have version = 1"),
        (lambda m: [m], "was not written by jaxgrasp evaluate"),
    ],
)
def test_a_manifest_that_is_not_ours_is_said(sets, half, change, words):
    path = half / "manifest.json"
    path.write_text(json.dumps(change(json.loads(path.read_text()))))
    with pytest.raises(GraspFileError, match=words):
        streamed(sets, half, resume=True, methods=("B",))


def test_a_manifest_that_is_nested_without_end_is_said(sets, half):
    (half / "manifest.json").write_text("[" * 100_000)
    with pytest.raises(GraspFileError, match="was not written by jaxgrasp evaluate"):
        streamed(sets, half, resume=True, methods=("B",))


def test_a_stream_stops_before_computing_at_a_bad_grasp(sets, tmp_path):
    points = sets.points.copy()
    points[-1] = np.inf
    spoiled = dataclasses.replace(sets, points=points)
    with pytest.raises(jaxgrasp.GraspError, match=r"points\[39, 4\]"):
        streamed(spoiled, tmp_path)
    assert os.listdir(tmp_path) == []
    outcome = streamed(spoiled, tmp_path, skip_bad=True)
    assert outcome.summary.set_aside == 1
    _, (results,) = read_results(tmp_path)
    assert 39 not in results["grasp"]


def test_resuming_with_other_data_is_refused(sets, tmp_path):
    stream_plan = plan()
    with pytest.raises(KeyboardInterrupt):
        evaluate_stream(
            Interrupted(sets),
            stream_plan,
            ResultFolder(tmp_path, stream_plan.identity("sets", MemorySource(sets)), resume=False),
        )
    changed_sets = dataclasses.replace(sets, squeeze=2 * sets.squeeze)
    with pytest.raises(GraspFileError, match="sets has changed since these results were written: they cannot"):
        streamed(changed_sets, tmp_path, resume=True)


@pytest.mark.parametrize("name", ["results.npz", "shard-00000.npz"])
def test_files_of_unknown_origin_are_left_alone(sets, tmp_path, name):
    (tmp_path / name).write_bytes(b"mine")
    with pytest.raises(GraspFileError, match=f"it holds {name} of unknown origin"):
        streamed(sets, tmp_path)
    assert (tmp_path / name).read_bytes() == b"mine"


def test_a_run_that_fails_leaves_earlier_results(sets, tmp_path):
    streamed(sets, tmp_path, methods=("B",))
    before = (tmp_path / "results.npz").read_bytes()
    spoiled = dataclasses.replace(sets, friction=np.full_like(sets.friction, np.nan))
    with pytest.raises(jaxgrasp.GraspError):
        streamed(spoiled, tmp_path, overwrite=True, methods=("B",))
    assert (tmp_path / "results.npz").read_bytes() == before


@pytest.mark.parametrize("text", ["[1]", "{", '{"complete": true}', '{"complete": true, "shards": [{"file": "../x"}]}'])
def test_a_foreign_manifest_is_refused(sets, tmp_path, text):
    (tmp_path / "manifest.json").write_text(text)
    with pytest.raises(GraspFileError, match="not written by jaxgrasp|jaxgrasp evaluate does not write"):
        streamed(sets, tmp_path)


def test_nothing_usable_is_said(sets):
    spoiled = dataclasses.replace(sets, friction=np.full_like(sets.friction, np.nan))
    nothing = evaluate(spoiled, skip_bad=True, methods=("B",))
    assert summary_text(nothing.summary, nothing.times, 1.0).startswith("no usable grasps; 40 bad grasps set aside")


@pytest.mark.parametrize("devices", [1, 2, 6, 12])
def test_chunks_are_filled_no_further_than_needed(devices):
    (block,) = engine.blocks(make_sets([4] * 1600), 1600, devices)
    assert 1600 <= len(block.wrench) < 1600 + devices and len(block.wrench) % devices == 0
    (least,) = engine.blocks(make_sets([4] * 3), 3, devices)
    assert len(least.wrench) == devices * engine.LEAST_BLOCK


def test_integers_are_taken_as_numbers(unchecked):
    points = np.array([[[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]]])
    grasp = jaxgrasp.Grasp(points, -points.astype(float), np.full((1, 4), 0.5), np.ones((1, 4)))
    result = evaluate(grasp, np.array([[0, 0, 0.75, 0, 0, 0]]), methods=("B",)).results["B"]
    np.testing.assert_allclose(result.forces[:, 0, 2], 0.1875)
    with pytest.raises(ValueError, match="dtype is float16: expected float32 or float64"):
        evaluate(grasp, np.zeros(6), dtype="float16")


def test_shapes_that_only_happen_to_fit_are_refused(unchecked):
    grasp = make_sets([4] * 5).padded(4)
    turned = dataclasses.replace(grasp, friction=grasp.friction.T)
    with pytest.raises(
        jaxgrasp.GraspError, match=r"friction is an array of shape \(4, 5\): expected the shape \(5, 4\)"
    ):
        evaluate(turned, np.zeros(6))


def test_an_unwritable_folder_is_refused(sets, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(GraspFileError, match="cannot be written"):
        streamed(sets, tmp_path / "file" / "out")


def test_summaries_survive_json(evaluation):
    data = json.loads(json.dumps(to_json(evaluation.summary)))
    assert_same_summary(from_json(data), evaluation.summary)


@pytest.mark.slow
def test_summaries_merge(sets, evaluation):
    halves = [evaluate(sets.rows(part)).summary for part in (slice(0, 17), slice(17, None))]
    merged = halves[0].merged(halves[1])
    assert merged.problems == evaluation.summary.problems
    for name, method in evaluation.summary.methods.items():
        np.testing.assert_array_equal(merged.methods[name].verdicts, method.verdicts)
    np.testing.assert_array_equal(
        merged.comparisons["A"].price.counts, evaluation.summary.comparisons["A"].price.counts
    )


def test_the_text_says_the_numbers(evaluation):
    text = summary_text(evaluation.summary, evaluation.times, 1.5)
    assert text.startswith("40 grasps of 2 to 5 contacts, 155 contacts in all, 80 wrenches")
    holds = evaluation.summary.methods["B-optimum"].count(Verdict.CLOSED_FORM_OPTIMAL, Verdict.OPTIMAL)
    assert f"{100 * holds / 80:.1f} %" in text
    assert "price of friction" in text and "1.5 s in all" in text


def test_an_evaluation_prints_its_summary(evaluation):
    text = str(evaluation)
    assert "40 grasps of 2 to 5 contacts" in text and len(text.splitlines()) < 30
    # Quantiles out of a histogram are said to be about right, the largest is exact.
    line = next(line for line in text.splitlines() if line.startswith("B: distance"))
    assert line.count("~") <= 2 and not line.split()[-2].startswith("~")
