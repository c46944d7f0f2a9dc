"""A real Ray: results are those of one process, and what is killed, lost, damaged or full costs nothing but time."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
import uuid
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from itertools import chain
from pathlib import Path

import numpy as np
import pytest

import jaxgrasp
from jaxgrasp.batch.contact_sets import ContactSets
from jaxgrasp.batch.evaluation import evaluate
from jaxgrasp.batch.shards import names_checksum
from tests.batch.conftest import make_sets

pytest.importorskip("ray")
parquet = pytest.importorskip("pyarrow.parquet")
pytestmark = [
    pytest.mark.slow,
    pytest.mark.realtime,
    pytest.mark.skipif(not Path("/proc/self/environ").exists(), reason="reads /proc"),
]
METHODS = ("B", "B-optimum")
OPTIONS = ["--methods", *METHODS, "--chunk", "128", "--no-report", "--cluster", "local", "--workers", "2"]
MARK = "JAXGRASP_TEST_CLUSTER"
PATIENCE = 900.0
"""Seconds: on a machine that is busy Ray takes minutes to start, and compiling as long."""


def marked(mark: str) -> list[int]:
    """List the ids of the processes that started with this mark in their environment."""
    processes = []
    for path in Path("/proc").glob("[0-9]*/environ"):
        try:
            if f"{MARK}={mark}\0".encode() in path.read_bytes():
                processes.append(int(path.parent.name))
        except OSError:
            continue
    return processes


def name_of(process: int) -> str:
    try:
        return Path(f"/proc/{process}/cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace")
    except OSError:
        return ""


def wait_until(what: Callable[[], object], seconds: float = PATIENCE):
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if value := what():
            return value
        time.sleep(0.05)
    raise AssertionError(f"not within {seconds} s")


@pytest.fixture
def mark() -> Iterator[str]:
    """Yield a mark for the processes of a test, and check afterwards that none of them is left."""
    identifier = uuid.uuid4().hex
    yield identifier
    try:
        wait_until(lambda: not marked(identifier), 120)
    except AssertionError:
        left = [name_of(process) for process in marked(identifier)]
        assert not left, left
    finally:
        for process in marked(identifier):
            os.kill(process, signal.SIGKILL)


@contextmanager
def started_process(mark: str, *command: object) -> Iterator[subprocess.Popen]:
    process = subprocess.Popen(
        [sys.executable, *map(str, command)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {MARK: mark, "RAY_USAGE_STATS_ENABLED": "0"},
    )
    with process:
        try:
            yield process
        finally:
            process.kill()


def outputs_of(process: subprocess.Popen) -> tuple[str, str]:
    return process.communicate(timeout=PATIENCE)


def jaxgrasp_evaluate(mark: str, *arguments: object):
    return started_process(mark, "-m", "jaxgrasp.cli.main", "evaluate", *arguments)


def write_files(folder: Path, sets: ContactSets, count: int) -> list[Path]:
    folder.mkdir()
    cuts = np.linspace(0, len(sets), count + 1).astype(int)
    files = [folder / f"part-{number}.parquet" for number in range(count)]
    for file, first, last in zip(files, cuts[:-1], cuts[1:], strict=True):
        jaxgrasp.save_grasps(file, sets.rows(slice(first, last)))
    return files


def named(sets: ContactSets) -> ContactSets:
    return replace(sets, labels={"name": np.array([f"g{number}" for number in range(len(sets))])})


@pytest.fixture(scope="module")
def few() -> ContactSets:
    return named(make_sets([5, 3, 4] * 20))


@pytest.fixture(scope="module")
def many() -> ContactSets:
    """Return enough grasps for some seconds of work in each file."""
    block = make_sets([4] * 4000)
    copies = 30
    columns = {name: np.tile(array, (copies, *[1] * (array.ndim - 1))) for name, array in block.columns.items()}
    offsets, wrench = np.arange(4000 * copies + 1) * 4, np.tile(block.wrench, (copies, 1, 1))
    return named(ContactSets(**columns, offsets=offsets, wrench=wrench))


def manifest(out: Path) -> dict:
    return json.loads((out / "manifest.json").read_text())


def assert_all_there(out: Path, sets: ContactSets, files: list[Path]) -> None:
    content = manifest(out)
    assert content["complete"] and [entry["file"] for entry in content["shards"]] == [file.name for file in files]
    names = [parquet.read_table(out / file.name, columns=["name"])["name"].to_pylist() for file in files]
    assert [*chain.from_iterable(names)] == sets.labels["name"].tolist()
    assert content["totals"]["rows"] == len(sets)
    assert content["totals"]["names_out"] == names_checksum(sets.labels["name"])
    assert not [name for name in os.listdir(out) if name.endswith(".partial")]


@pytest.mark.always
def test_two_workers_say_what_one_process_says(few, folder, mark):
    files = write_files(folder / "in", few, 3)
    with jaxgrasp_evaluate(mark, "in", "--out", "out", *OPTIONS) as process:
        shown, errors = outputs_of(process)
    assert process.returncode == 0, errors
    assert errors == "3 files with 60 grasps, on a cluster (local) ...\n"
    assert "60 grasps of 3 to 5 contacts" in shown and "results: out" in shown
    assert_all_there(folder / "out", few, files)
    evaluation = evaluate(few, methods=METHODS)
    written = parquet.read_table([folder / "out" / file.name for file in files])
    for name, values in evaluation.table().items():
        np.testing.assert_array_equal(np.asarray(written[name].to_pylist()), values, err_msg=name)
    summary = json.loads((folder / "out" / "summary.json").read_text())["summary"]
    assert summary["ranked"]["reasons"]["HOLDS"] == evaluation.summary.ranked.holds


def workers_of(mark: str) -> list[int]:
    return [process for process in marked(mark) if "ray::MapWorker" in name_of(process)]


def niceness(process: int) -> int:
    return os.getpriority(os.PRIO_PROCESS, process)


def busy(process: subprocess.Popen, out: Path, count: int) -> bool:
    """Return True once ``count`` files are finished and the next one is begun, or the process has ended."""
    is_underway = len([*out.glob("[!.]*.parquet")]) >= count and any(out.glob(".*.partial"))
    return is_underway or process.poll() is not None


def test_a_worker_that_is_killed_loses_and_doubles_nothing(many, folder, mark):
    files = write_files(folder / "in", many, 8)
    with jaxgrasp_evaluate(mark, "in", "--out", "out", *OPTIONS) as process:
        for count in (1, 2):
            wait_until(partial(busy, process, folder / "out", count))
            assert process.poll() is None, "done before anything was killed"
            worker = workers_of(mark)[0]
            # Else what else runs on the machine would starve it.
            assert niceness(worker) == niceness(process.pid)
            os.kill(worker, signal.SIGKILL)
        _, errors = outputs_of(process)
    assert process.returncode == 0, errors
    assert_all_there(folder / "out", many, files)


def test_a_command_that_is_killed_is_taken_up(many, folder, mark):
    files = write_files(folder / "in", many, 8)
    with jaxgrasp_evaluate(mark, "in", "--out", "out", *OPTIONS) as process:
        entries = wait_until(lambda: (folder / "out" / "manifest.json").exists() and manifest(folder / "out")["shards"])
        process.kill()
    # Ray's agents look for their lost head for 60 s before they end.
    wait_until(lambda: not marked(mark), 120)
    assert not manifest(folder / "out")["complete"] and len(entries) < 8
    with jaxgrasp_evaluate(mark, "in", "--out", "out", *OPTIONS) as process:
        assert outputs_of(process)[1].endswith(
            "--resume goes on with it, --overwrite drops it; or choose another --out\n"
        )
    with jaxgrasp_evaluate(mark, "in", "--out", "out", *OPTIONS, "--resume") as process:
        shown, errors = outputs_of(process)
    assert process.returncode == 0, errors
    assert "of the grasps were done before" in shown
    assert_all_there(folder / "out", many, files)


def test_a_file_that_is_damaged_is_fatal_or_left_out_as_asked(few, folder, mark):
    files = write_files(folder / "in", few, 3)
    content = bytearray(files[1].read_bytes())
    content[len(content) // 3] ^= 4
    files[1].write_bytes(bytes(content))
    with jaxgrasp_evaluate(mark, "in", "--out", "out", *OPTIONS) as process:
        _, errors = outputs_of(process)
    assert process.returncode == 1
    assert errors.splitlines()[-1].startswith("jaxgrasp: ") and "part-1.parquet: it cannot be read as Parquet" in errors
    with jaxgrasp_evaluate(mark, "in", "--out", "out", *OPTIONS, "--overwrite", "--skip-damaged") as process:
        _, errors = outputs_of(process)
    assert process.returncode == 0 and "left out: " in errors
    content = manifest(folder / "out")
    assert [entry["file"] for entry in content["shards"]] == ["part-0.parquet", "part-2.parquet"]
    assert content["complete"] and "part-1.parquet" in content["skipped"][0]["error"]
    write_files(folder / "again", few, 3)
    shutil.copy(folder / "again" / "part-1.parquet", files[1])
    with jaxgrasp_evaluate(mark, "in", "--out", "out", *OPTIONS, "--resume") as process:
        _, errors = outputs_of(process)
    assert process.returncode == 0, errors
    assert_all_there(folder / "out", few, files)


@contextmanager
def small_disk(folder: Path, size: str) -> Iterator[Path]:
    folder.mkdir()
    mounted = subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={size}", "none", folder], capture_output=True)
    if mounted.returncode:
        pytest.skip("no small disk can be mounted")
    try:
        yield folder
    finally:
        subprocess.run(["umount", "-l", folder], check=True)


def test_a_disk_that_fills_is_one_line_and_goes_on_where_there_is_room(many, folder, mark):
    sets = many.rows(slice(0, 24_000))
    files = write_files(folder / "in", sets, 6)
    with small_disk(folder / "out", "6m") as out:
        with jaxgrasp_evaluate(mark, "in", "--out", out, *OPTIONS) as process:
            _, errors = outputs_of(process)
        last = errors.splitlines()[-1]
        assert process.returncode == 1 and last.startswith("jaxgrasp: ") and "No space left on device" in last
        finished_names = [path.name for path in out.glob("[!.]*.parquet")]
        assert 0 < len(finished_names) < 6 and not [*out.glob(".*.partial")]
        subprocess.run(["mount", "-o", "remount,size=60m", out], check=True)
        with jaxgrasp_evaluate(mark, "in", "--out", out, *OPTIONS, "--resume") as process:
            shown, errors = outputs_of(process)
        assert process.returncode == 0 and "of the grasps were done before" in shown, errors
        assert_all_there(out, sets, files)


TWO_NODES = """
import sys
from pathlib import Path
from ray.cluster_utils import Cluster
from jaxgrasp.batch.cluster_evaluation import ClusterPlan, evaluate_on_cluster, parquet_files, read_inputs
from jaxgrasp.batch.shard_evaluator import ShardFolder
from jaxgrasp.batch.stream import StreamPlan

store = 100 << 20
cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 1, "object_store_memory": store})
other = cluster.add_node(num_cpus=1, object_store_memory=store)
try:
    inputs = read_inputs(parquet_files([Path("in")]), False, print)
    plan = StreamPlan(methods=("B", "B-optimum"), chunk=128)
    files = [task.file for task in inputs.tasks]
    folder, done = ShardFolder(Path("out"), plan.options, "v", files, False), []

    def progress(grasps):
        done.append(grasps)
        if len(done) == 2:
            cluster.remove_node(other, allow_graceful=False)
            print("removed", flush=True)

    found = evaluate_on_cluster(inputs, plan, ClusterPlan(cluster.address, 2), folder, progress)
    print("summary", found.summary.grasps)
finally:
    cluster.shutdown()
"""


def test_a_machine_that_is_lost_loses_and_doubles_nothing(many, folder, mark):
    files = write_files(folder / "in", many, 8)
    with started_process(mark, "-c", TWO_NODES) as process:
        shown, errors = outputs_of(process)
    assert process.returncode == 0, errors
    assert "removed" in shown and f"summary {len(many)}" in shown
    assert_all_there(folder / "out", many, files)


MAPPED = """
import sys
from jaxgrasp.batch import BatchEvaluator
from jaxgrasp.batch.cluster_evaluation import connected

with connected("local", 2) as ray:
    data = ray.data.read_parquet("in", override_num_blocks=6)
    evaluator = BatchEvaluator(("B", "B-optimum"), contacts=(6,), rows=128)
    for form in ("numpy", "pyarrow"):
        found = data.map_batches(evaluator, batch_size=7, batch_format=form)
        found.drop_columns(["B.forces", "B-optimum.forces"]).write_parquet(form)
"""


def test_rows_that_ray_hands_on_have_the_same_answers(few, folder, mark):
    write_files(folder / "in", few, 3)
    with started_process(mark, "-c", MAPPED) as process:
        _, errors = outputs_of(process)
    assert process.returncode == 0, errors
    expected_table = evaluate(few, methods=METHODS).table()
    for form in ("numpy", "pyarrow"):
        table = parquet.read_table(folder / form)
        order = np.argsort([int(name[1:]) for name in table["name"].to_pylist()])
        for name, values in expected_table.items():
            if name != "grasp":
                np.testing.assert_array_equal(np.asarray(table[name].to_pylist())[order], values, err_msg=name)


def test_a_cluster_that_is_not_there_is_one_line(few, folder, mark):
    write_files(folder / "in", few, 1)
    with jaxgrasp_evaluate(mark, "in", "--out", "out", "--cluster", "127.0.0.1:1") as process:
        _, errors = outputs_of(process)
    last = errors.splitlines()[-1]
    assert process.returncode == 1 and last.startswith("jaxgrasp: no cluster is found at '127.0.0.1:1'"), errors
