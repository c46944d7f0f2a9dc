"""Evaluation of many files on a cluster by Ray: list of the files, distribution to workers, and the common summary.

Ray (the extra ``cluster``) places the work on machines, and does it again where one fails.
"""

import json
import logging
import os
import socket
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from jaxgrasp.batch.engine import Times
from jaxgrasp.batch.file_error import GraspFileError
from jaxgrasp.batch.parquet_file import opened_parquet
from jaxgrasp.batch.remote_file import RemoteFile, remote_files
from jaxgrasp.batch.shard_evaluator import ShardEvaluator, ShardFolder, ShardReport, ShardTask
from jaxgrasp.batch.stream import StreamPlan, StreamResult
from jaxgrasp.files.stderr import redirected_stderr
from jaxgrasp.validation.optional_library import optional_library

MISSING = "--cluster needs Ray: pip install 'jaxgrasp[cluster]'"
SETTINGS = {"RAY_USAGE_STATS_ENABLED": "0", "RAY_BACKEND_LOG_LEVEL": "fatal", "RAY_worker_niceness": "0"}
"""Settings of Ray's own processes: nothing is sent to its makers, warnings of its inner working are not shown, and
workers are as urgent as the command, where Ray would have them wait for all else that runs on the machine."""
LOCAL = "local"
OBJECT_STORE = 200 << 20
"""Bytes of Ray's shared memory on this machine: what passes through it are names and reports."""

CONNECT_SECONDS = 10.0
STARTS = 3
"""Ray gives up after half a minute, which on a machine that is busy is too little to start in."""


class ClusterError(OSError):
    """Error of a cluster that cannot be reached, or that cannot go on."""


def ray_library() -> Any:
    """Import Ray with its module for data, and return it.

    Raises:
        ImportError: if it is not installed; the message names the command that installs it.
    """
    return optional_library("ray", "ray.data", missing=MISSING)


@contextmanager
def connected(address: str, cpus: int | None = None) -> Iterator[Any]:
    """Connect to Ray until the block ends; an existing connection of this process is used and left open.

    Args:
        address: ``"local"`` starts one on this machine alone, and ends it; ``"auto"`` takes the one that is running
            here, or the one that ``RAY_ADDRESS`` names; anything else is an address.
        cpus: of this machine, for a local one; all where not given.

    Raises:
        ImportError: where Ray is not installed.
        ClusterError: where there is none at that address.
    """
    with _settings(), _quiet_logs():
        ray = ray_library()
        if ray.is_initialized():
            yield ray
            return
        _check_address(address)
        _begin(ray, address, cpus)
        try:
            yield ray
        finally:
            ray.shutdown()


def _begin(ray: Any, address: str, cpus: int | None) -> None:
    local_options = {"num_cpus": cpus, "object_store_memory": OBJECT_STORE, "include_dashboard": False}
    for attempts_left in reversed(range(STARTS if address == LOCAL else 1)):
        try:
            with _no_stderr():
                ray.init(
                    address=address,
                    log_to_driver=False,
                    logging_level=logging.CRITICAL,
                    configure_logging=False,
                    **(local_options if address == LOCAL else {}),
                )
            return
        except Exception as error:  # Ray lets out errors of many kinds, plain ones too.
            ray.shutdown()
            if not attempts_left:
                line = str(error).strip().split("\n")[0]
                if address == LOCAL:
                    raise ClusterError(f"Ray does not start on this machine ({line})") from None
                raise _not_found(address, line) from None


def _not_found(address: str, cause: object) -> ClusterError:
    return ClusterError(f"no cluster is found at {address!r} ({cause}): ray start --head begins one")


def _check_address(address: str) -> None:
    """Check that a server listens at ``HOST:PORT``, since Ray itself takes minutes to give up.

    Raises:
        ClusterError: if no server does.
    """
    host, _, port = address.rpartition(":")
    if not host or "/" in host or not port.isdecimal():
        return
    try:
        socket.create_connection((host, int(port)), CONNECT_SECONDS).close()
    except (OSError, OverflowError) as error:
        raise _not_found(address, error) from None


@contextmanager
def _settings() -> Iterator[None]:
    """Set ``SETTINGS`` in the environment until the block ends; variables that the user set stay.

    Ray reads them as it is imported and when it starts processes.
    """
    added = {name: value for name, value in SETTINGS.items() if name not in os.environ}
    os.environ.update(added)
    try:
        yield
    finally:
        for name in added:
            os.environ.pop(name, None)


@contextmanager
def _no_stderr() -> Iterator[None]:
    """Discard stderr until the block ends, since Ray's compiled part writes a notice to it at the start."""
    with open(os.devnull, "w") as nowhere, redirected_stderr(nowhere):
        yield


@contextmanager
def _quiet_logs() -> Iterator[None]:
    loggers = [logging.getLogger(name) for name in ("ray", "ray.data")]
    levels = [logger.level for logger in loggers]
    try:
        with _no_progress_bars():
            for logger in loggers:
                logger.setLevel(logging.CRITICAL)
            yield
    finally:
        for logger, level in zip(loggers, levels, strict=True):
            logger.setLevel(level)


@contextmanager
def _no_progress_bars() -> Iterator[None]:
    """Switch off Ray's progress bars until the block ends: they overwrite the bar of this package."""
    context = ray_library().data.DataContext.get_current()
    before = context.enable_progress_bars, context.print_on_execution_start
    context.enable_progress_bars = context.print_on_execution_start = False
    try:
        yield
    finally:
        context.enable_progress_bars, context.print_on_execution_start = before


def mapped(
    ray: Any, worker: type, arguments: tuple, column: str, items: list[str], workers: int | None, gpus: float
) -> Iterator[dict[str, Any]]:
    """Yield the results of ``worker(*arguments)`` for batches of a single item, ``{column: [item]}``, as they finish.

    Args:
        ray: the module that ``connected`` yields.
        worker: a class of callables, of which each process of the cluster keeps one.
        arguments: of its constructor.
        column: name of the items.
        items: the work items; an item whose process or machine is lost is done again.
        workers: processes, of one core each; one for each core of the cluster where not given.
        gpus: of each process.

    Raises:
        ClusterError: where the cluster cannot go on.
    """
    size = workers or max(1, int(ray.cluster_resources().get("CPU", 1)))
    try:
        data = ray.data.from_items([{column: item} for item in items], override_num_blocks=len(items))
        done = data.map_batches(
            worker,
            fn_constructor_args=arguments,
            batch_size=1,
            compute=ray.data.ActorPoolStrategy(size=min(size, len(items)), max_tasks_in_flight_per_actor=1),
            num_cpus=1,
            num_gpus=gpus or None,
        )
        yield from done.iter_batches(batch_size=None, batch_format="numpy", prefetch_batches=0)
    except ray.exceptions.RayError as error:
        lines = [line for line in str(error).splitlines() if line.strip()]
        raise ClusterError(
            f"the cluster cannot go on ({lines[-1].strip() if lines else type(error).__name__})"
        ) from error


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
