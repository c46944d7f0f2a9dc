"""Many files to many files of results, without a cluster: what one worker does, and what a folder of them says."""

import json
import os
import re
import resource
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

import jaxgrasp
from jaxgrasp.batch import parquet_file
from jaxgrasp.batch.cluster_evaluation import parquet_files, read_inputs
from jaxgrasp.batch.contact_sets import ContactSets
from jaxgrasp.batch.evaluation import evaluate
from jaxgrasp.batch.file_error import GraspFileError
from jaxgrasp.batch.shard_evaluator import ShardEvaluator, ShardFolder, ShardTask
from jaxgrasp.batch.shards import MODULUS, names_checksum
from jaxgrasp.batch.sources import open_source
from jaxgrasp.batch.stream import StreamPlan
from jaxgrasp.batch.summary import to_json
from jaxgrasp.cli.main import main
from tests.batch.conftest import make_sets

parquet = pytest.importorskip("pyarrow.parquet")
PLAN = StreamPlan(methods=("B", "B-optimum"), chunk=128)
COUNTS = (50, 30, 41)


@pytest.fixture(scope="module")
def sets() -> ContactSets:
    made = make_sets([5, 3, 4] * 40 + [2])
    made.wrench[::9] = [0, 0, 0, 0, 0, 5]
    return replace(made, labels={"name": np.array([f"g{number}" for number in range(len(made))])})


@pytest.fixture
def files(sets, folder):
    """Write three files with all the grasps; return their paths."""
    first, made = 0, []
    (folder / "in").mkdir()
    for number, count in enumerate(COUNTS):
        made.append(folder / "in" / f"part-{number}.parquet")
        jaxgrasp.save_grasps(made[-1], sets.rows(slice(first, first + count)))
        first += count
    return made


def tasks_of(files) -> list[ShardTask]:
    return read_inputs(files, False, print).tasks


def opened(files, resume=False, overwrite=False) -> ShardFolder:
    return ShardFolder(files[0].parent.parent / "out", PLAN.options, "v", [f.name for f in files], resume, overwrite)


def done(files, out: ShardFolder) -> ShardFolder:
    out.begin()
    worker = ShardEvaluator(PLAN, str(out.folder))
    for task in tasks_of(files):
        out.add(worker.report(task).entry)
    out.write()
    return out


def test_files_say_together_what_evaluate_says_of_all_grasps_to_the_last_bit(sets, files):
    out = done(files, opened(files))
    inputs = read_inputs(files, False, print)
    summary, evaluation = out.finish([], inputs.grasps), evaluate(sets, methods=PLAN.methods)
    merged, direct = to_json(summary), to_json(evaluation.summary)
    for one_summary, data in ((summary, merged), (evaluation.summary, direct)):
        for name, method in one_summary.methods.items():
            assert method.angles.sum() > 0  # of a sample, which is another in each part
            del data["methods"][name]["angles"]
    assert merged == direct
    table, written = evaluation.table(), parquet.read_table(sorted(out.folder.glob("*.parquet")))
    for name, values in table.items():
        np.testing.assert_array_equal(np.asarray(written[name].to_pylist()), values, err_msg=name)
    forces = np.concatenate([np.stack(row) for row in written["B-optimum.forces"].to_numpy()])
    np.testing.assert_array_equal(forces, evaluation.results["B-optimum"].forces[:, 0])
    content = json.loads((out.folder / "manifest.json").read_text())
    assert content["complete"] and content["totals"]["grasps"] == content["totals"]["rows"] == len(sets)
    assert content["totals"]["names_out"] == names_checksum(sets.labels["name"])
    holds = sum(entry["verdicts"]["B-optimum"].get("OPTIMAL", 0) for entry in content["shards"])
    assert holds == direct["methods"]["B-optimum"]["verdicts"]["OPTIMAL"]
    rows = out.first_rows(60)
    np.testing.assert_array_equal(rows["name"], table["name"][:60])
    assert not [name for name in os.listdir(out.folder) if name.endswith(".partial")]


def test_what_is_done_is_kept_and_what_changed_is_done_again(sets, files):
    out = done(files, opened(files))
    out.finish([], read_inputs(files, False, print).grasps)
    worker = ShardEvaluator(PLAN, str(out.folder))
    jaxgrasp.save_grasps(files[1], replace(sets.rows(slice(50, 80)), squeeze=2 * sets.rows(slice(50, 80)).squeeze))
    path = out.folder / files[2].name
    path.write_bytes(path.read_bytes()[:-1])
    again = opened(files, resume=True)
    reports = [worker.report(replace(task, earlier=again.entry(task.file))) for task in tasks_of(files)]
    assert [report.kept for report in reports] == [True, False, False]
    assert reports[0].entry == again.entry(files[0].name)
    assert reports[2].entry["sha256"] == again.entry(files[2].name)["sha256"]


def test_grasps_that_are_lost_or_doubled_are_found_in_the_end(files):
    grasps = read_inputs(files, False, print).grasps
    out = done(files, opened(files))
    lost = replace_entry(out, grasps=49)
    with pytest.raises(GraspFileError, match=r"it has 120 grasps: expected 121"):
        out.finish([], grasps)
    out.add(lost | {"names_out": lost["names_out"] ^ 1})
    with pytest.raises(GraspFileError, match="the names of its grasps are not those of the input"):
        out.finish([], grasps)
    out.add(lost)
    out.drop(files[1].name)
    with pytest.raises(GraspFileError, match="it has 91 grasps"):
        out.finish([], grasps)


def replace_entry(out: ShardFolder, **changes) -> dict:
    entry = out.entry("part-0.parquet")
    out.add(entry | changes)
    return entry


def test_a_folder_of_others_is_refused(files):
    out = done(files, opened(files))
    with pytest.raises(GraspFileError, match="it holds an unfinished evaluation: --resume goes on"):
        opened(files)
    with pytest.raises(GraspFileError, match="it holds results of part-2.parquet, which is not among the inputs"):
        opened(files[:2], resume=True)
    changed_plan = replace(PLAN, methods=("B",))
    with pytest.raises(GraspFileError, match=r"methods = .*: they cannot be resumed"):
        ShardFolder(out.folder, changed_plan.options, "v", [file.name for file in files], resume=True)
    (out.folder / "mine.parquet").write_bytes(b"mine")
    for name in (".part-1.parquet.7.partial", ".part-1.parquet.00a9bfc926dc0347.partial"):
        (out.folder / name).write_bytes(b"half")
    done(files[:2], opened(files[:2], overwrite=True))
    assert sorted(os.listdir(out.folder)) == ["manifest.json", "mine.parquet", "part-0.parquet", "part-1.parquet"]
    (out.folder / "manifest.json").unlink()
    with pytest.raises(GraspFileError, match="of unknown origin"):
        opened(files)


def cut_short(path):
    path.write_bytes(path.read_bytes()[:-300])


def one_bit(path):
    content = bytearray(path.read_bytes())
    content[len(content) // 3] ^= 4
    path.write_bytes(bytes(content))


def bad_grasp(path):
    table = parquet.read_table(path)
    friction = table["friction"].to_pylist()
    friction[7][1] = -1.0
    at = table.column_names.index("friction")
    parquet.write_table(table.set_column(at, "friction", [friction]), path)


@pytest.mark.parametrize(
    ("harm", "message"),
    [
        (cut_short, "it cannot be read as Parquet"),
        (one_bit, "it cannot be read as Parquet"),
        (bad_grasp, "friction[7, 1] is -1.0"),
        (lambda path: path.unlink(), "it cannot be read"),
    ],
)
def test_a_file_that_is_damaged_is_named_and_leaves_nothing(files, harm, message):
    tasks = tasks_of(files)
    out = files[0].parent.parent / "out"
    out.mkdir()
    harm(files[0])
    report = ShardEvaluator(PLAN, str(out)).report(tasks[0])
    assert report.damaged and report.entry is None
    assert "part-0.parquet" in report.error and message in report.error and "\n" not in report.error
    assert os.listdir(out) == []


def test_a_bad_grasp_is_set_aside_and_counted(files):
    bad_grasp(files[0])
    out = files[0].parent.parent / "out"
    out.mkdir()
    (task, *_) = tasks_of(files)
    entry = ShardEvaluator(replace(PLAN, skip_bad=True), str(out)).report(task).entry
    assert (entry["grasps"], entry["rows"], entry["set_aside"]) == (50, 49, 1)
    assert entry["names_aside"] == names_checksum(np.array(["g7"]))
    assert (entry["names_out"] + entry["names_aside"]) % MODULUS == entry["names_in"]


FULL = """
import resource, signal, sys
from jaxgrasp.batch.shard_evaluator import ShardEvaluator, ShardTask
from jaxgrasp.batch.stream import StreamPlan
worker = ShardEvaluator(StreamPlan(methods=("B",), chunk=128), "out")
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (4_000, resource.RLIM_INFINITY))
report = worker.report(ShardTask(sys.argv[1], "part-0.parquet", 0))
assert report.entry is None and not report.damaged
print(report.error)
"""


@pytest.mark.slow
def test_a_disk_that_is_full_is_one_line_and_leaves_nothing(files, folder):
    assert resource.RLIMIT_FSIZE is not None
    (folder / "out").mkdir()
    completed = subprocess.run(
        [sys.executable, "-c", FULL, files[0]], capture_output=True, text=True, check=True
    ).stdout
    assert completed == "out/part-0.parquet cannot be written (File too large): --resume goes on\n"
    assert os.listdir("out") == []


def test_files_are_asked_for_by_name_or_by_folder(files, folder):
    assert parquet_files([folder / "in"]) == parquet_files(files) == files
    (folder / "empty").mkdir()
    (folder / "in2").mkdir()
    (folder / "in2" / "part-1.parquet").write_bytes(files[1].read_bytes())
    for arguments, message in (
        ([folder / "empty"], "it holds no file that ends in .parquet"),
        ([folder / "a.npz"], "a cluster reads files that end in .parquet"),
        ([folder / "in", folder / "in2"], "in2/part-1.parquet: it has the same name as "),
    ):
        with pytest.raises(GraspFileError, match=re.escape(message)):
            parquet_files(arguments)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["in/part-0.parquet", "in/part-1.parquet"], "2 files are given: expected one, or --cluster local"),
        (["in/part-0.parquet", "--workers", "2"], "--workers is given without --cluster"),
        (["--cluster", "local"], "--cluster is given without files"),
        (["in", "--cluster", "local", "--workers", "0"], "workers is 0: expected"),
        (["in", "--cluster", "local", "--gpus", "-1"], "gpus is -1.0: expected"),
        (["in", "--cluster", "local", "--table", "csv"], "table is 'csv': expected auto or parquet"),
    ],
)
def test_what_does_not_go_together_is_one_line(files, capsys, arguments, message):
    assert main(["evaluate", *arguments]) == 1
    captured = capsys.readouterr()
    assert captured.out == "" and message in captured.err and captured.err.count("\n") == 1


def test_without_ray_one_line_says_what_to_install(files, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    assert main(["evaluate", "in", "--cluster", "local"]) == 1
    assert capsys.readouterr().err == "jaxgrasp: --cluster needs Ray: pip install 'jaxgrasp[cluster]'\n"


def test_the_checksum_of_names_hangs_on_each_name_alone():
    names = np.array(["a", "b", "ab", "ba", "плошка", "", "a" * 40])
    checksum = names_checksum(names)
    assert checksum == names_checksum(names[::-1]) == names_checksum(names.astype("U90"))
    assert (names_checksum(names[:3]) + names_checksum(names[3:])) % MODULUS == checksum
    for changed_names in (names[1:], [*names, "a"], ["b", *names[1:]], ["aa", *names[1:]]):
        assert names_checksum(np.array(changed_names)) != checksum
    numbers = np.arange(100_000).astype(str)
    checksums = {names_checksum(numbers[k : k + 1]) for k in range(300)}
    assert len(checksums) == 300


@pytest.mark.parametrize("group", [1, 7, 200])
def test_row_groups_are_read_a_few_rows_at_a_time(sets, folder, monkeypatch, group):
    monkeypatch.setattr(parquet_file, "ROWS_READ", 5)
    jaxgrasp.save_grasps("whole.parquet", sets)
    parquet.write_table(parquet.read_table("whole.parquet"), "groups.parquet", row_group_size=group)
    with open_source("groups.parquet") as source:
        assert len(source) == len(sets) and source.largest == 5
        parts = [*source.chunks(17, 3)]
    assert [len(part) for part in parts][:-1] == [17] * (len(parts) - 1)
    read, expected = np.concatenate([part.points for part in parts]), sets.rows(slice(3, None))
    np.testing.assert_array_equal(read, expected.points)
    names = np.concatenate([part.labels["name"] for part in parts])
    np.testing.assert_array_equal(names, expected.labels["name"])
    with open_source("whole.parquet") as whole_source, open_source("groups.parquet") as source:
        assert source.fingerprint == whole_source.fingerprint
