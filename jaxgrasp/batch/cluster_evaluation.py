"""Evaluation of many files on a cluster: list of the files, distribution to workers, and the common summary."""

import json
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from jaxgrasp.batch.engine import Times
from jaxgrasp.batch.file_error import GraspFileError
from jaxgrasp.batch.parquet_file import opened_parquet
from jaxgrasp.batch.ray_cluster import LOCAL, connected, mapped
from jaxgrasp.batch.remote_file import RemoteFile, remote_files
from jaxgrasp.batch.shard_evaluator import ShardEvaluator, ShardFolder, ShardReport, ShardTask
from jaxgrasp.batch.stream import StreamPlan, StreamResult

ENDING = ".parquet"


@dataclass(frozen=True)
class ClusterPlan:
    """Choice of the cluster and of its processes for an evaluation."""

    where: str = LOCAL
    """``"local"``, ``"auto"``, or the address of a cluster."""
    workers: int | None = None
    """Processes, of one core each; one for each core of the cluster where not given."""
    gpus: float = 0.0
    """GPUs of each process."""
    skip_damaged: bool = False
    """True to name files that cannot be read and go on with the others."""


def parquet_files(paths: Sequence[Path | RemoteFile]) -> list[Path | RemoteFile]:
    """List the Parquet files of these paths; a folder stands for the files in it, in the order of their names.

    An address may also hold a pattern, such as ``s3://bucket/folder/part-*.parquet``.

    Raises:
        GraspFileError: for other files, a folder without Parquet files, and names that occur twice.
    """
    files: list[Path | RemoteFile] = []
    for path in paths:
        listed: Sequence[Path | RemoteFile]
        if isinstance(path, RemoteFile):
            listed = remote_files(path, ENDING)
        else:
            listed = sorted(path.glob(f"*{ENDING}")) if path.is_dir() else [path]
        if not listed:
            raise GraspFileError(path, f"it holds no file that ends in {ENDING}")
        files += listed
    by_name: dict[str, Path | RemoteFile] = {}
    for file in files:
        if file.suffix != ENDING or file.name.startswith("."):
            raise GraspFileError(file, f"a cluster reads files that end in {ENDING}: jaxgrasp convert makes them")
        if file.name in by_name:
            raise GraspFileError(
                file, f"it has the same name as {by_name[file.name]}, and so would its results: rename one"
            )
        by_name[file.name] = file
    return files


@dataclass(frozen=True)
class ShardInputs:
    """Input files with their numbers of grasps."""

    tasks: list[ShardTask]
    grasps: dict[str, int]
    """Number of grasps of each file, by the file's name."""
    skipped: list[dict]
    """Files that cannot be opened, with the errors."""


def read_inputs(files: Sequence[Path | RemoteFile], skip_damaged: bool, announce: Callable[[str], None]) -> ShardInputs:
    """Read the number of grasps of each file from its Parquet footer, and number the grasps through all files.

    Raises:
        GraspFileError: for a file that cannot be opened, unless ``skip_damaged``.
    """
    inputs = ShardInputs([], {}, [])
    first = 0
    for file in files:
        try:
            with opened_parquet(file) as opened:
                count = opened.metadata.num_rows
        except GraspFileError as error:
            if not skip_damaged:
                raise
            announce(f"left out: {error}")
            inputs.skipped.append({"input": str(file), "error": str(error)})
            continue
        inputs.tasks.append(ShardTask(str(file.absolute()), file.name, first))
        inputs.grasps[file.name] = count
        first += count
    return inputs


def evaluate_on_cluster(
    inputs: ShardInputs,
    plan: StreamPlan,
    cluster: ClusterPlan,
    folder: ShardFolder,
    progress: Callable[[int], Any] = lambda grasps: None,
    announce: Callable[[str], None] = lambda text: None,
) -> StreamResult:
    """Evaluate every grasp of these files, a file by a process of the cluster, and write a file of results for each.

    Folders are those of a file system that all machines share. What a process or a machine loses, another does again.
    ``progress`` is told of the grasps of every finished file.

    Raises:
        GraspFileError: for a file that is damaged, unless told to skip such, and where what was written is not what
            was read.
        ClusterError: where there is no cluster, or it cannot go on.
        OSError: where results cannot be written; what is finished stays.
    """
    started = time.perf_counter()
    tasks = [_with_earlier(task, folder) for task in inputs.tasks]
    if not tasks:
        raise GraspFileError(folder.folder, "there are no grasps to evaluate")
    grasps, skipped, resumed = dict(inputs.grasps), list(inputs.skipped), 0
    times = Times(solving=dict.fromkeys(plan.methods, 0.0))
    with ExitStack() as stack:
        ray = stack.enter_context(connected(cluster.where, cluster.workers))
        folder.begin()
        stack.callback(folder.write)
        for report in _reports(ray, plan, cluster, folder, tasks):
            count = grasps[report.task.file]
            if report.entry is not None:
                folder.add(report.entry)
                resumed += count if report.kept else 0
                _add(times, report.times)
            elif report.damaged and cluster.skip_damaged:
                announce(f"left out: {report.error}")
                folder.drop(report.task.file)
                skipped.append({"input": report.task.path, "error": report.error})
                del grasps[report.task.file]
            elif report.damaged:
                raise ValueError(report.error)
            else:
                raise OSError(report.error)
            progress(count)
    summary = folder.finish(skipped, grasps)
    return StreamResult(summary, times, time.perf_counter() - started, resumed)


def _with_earlier(task: ShardTask, folder: ShardFolder) -> ShardTask:
    return replace(task, earlier=folder.entry(task.file))


def _reports(
    ray: Any, plan: StreamPlan, cluster: ClusterPlan, folder: ShardFolder, tasks: list[ShardTask]
) -> Iterator[ShardReport]:
    items = [json.dumps(asdict(task)) for task in tasks]
    arguments = (plan, str(folder.folder.absolute()))
    for batch in mapped(ray, ShardEvaluator, arguments, "task", items, cluster.workers, cluster.gpus):
        for text in batch["report"]:
            fields = json.loads(str(text))
            yield ShardReport(**fields | {"task": ShardTask(**fields["task"])})


def _add(times: Times, more: dict) -> None:
    """Add the seconds that one process spent."""
    if more:
        times.compiling += more["compiling"]
        times.problems += more["problems"]
        for name, seconds in more["solving"].items():
            times.solving[name] += seconds
