"""``jaxgrasp evaluate --cluster``: many files, each by some process of a cluster."""

from pathlib import Path

from tqdm import tqdm

from jaxgrasp.batch.cluster_evaluation import ClusterPlan, evaluate_on_cluster, parquet_files, read_inputs
from jaxgrasp.batch.manifest import held_folder
from jaxgrasp.batch.remote_file import parse_path
from jaxgrasp.batch.shard_folder import ShardFolder
from jaxgrasp.batch.sources import open_source
from jaxgrasp.batch.stream import StreamPlan
from jaxgrasp.cli.evaluate_arguments import Evaluate
from jaxgrasp.cli.evaluate_outcome import say_outcome, write_page
from jaxgrasp.cli.machine import versions
from jaxgrasp.cli.terminal import announce, show


def evaluate_files(arguments: Evaluate, plan: StreamPlan, out: Path) -> None:
    """Evaluate the files that the arguments name, and show and write what is said of them all."""
    cluster = ClusterPlan(
        arguments.cluster or ClusterPlan.where, arguments.workers, arguments.gpus, arguments.skip_damaged
    )
    inputs = read_inputs(parquet_files([parse_path(file) for file in arguments.file]), cluster.skip_damaged, announce)
    files, total = [task.file for task in inputs.tasks], sum(inputs.grasps.values())
    with held_folder(out, announce):
        folder = ShardFolder(out, plan.options, versions(), files, arguments.resume, arguments.overwrite)
        with tqdm(total=total, unit=" grasps", disable=None, leave=False) as bar:
            announce(f"{len(files):,} files with {total:,} grasps, on a cluster ({cluster.where}) ...")
            outcome = evaluate_on_cluster(inputs, plan, cluster, folder, bar.update, announce)
        with open_source(
            next(task.path for task in inputs.tasks if folder.entry(task.file)), plan.adjustments
        ) as source:
            doubts = say_outcome(source, plan, outcome, arguments, _title(arguments), out)
        if outcome.resumed:
            show(f"{outcome.resumed:,} of the grasps were done before")
        write_page(folder.first_rows, outcome, arguments, _title(arguments), out, doubts)


def _title(arguments: Evaluate) -> str:
    names = [parse_path(file).name for file in arguments.file]
    return names[0] if len(names) == 1 else f"{names[0]} ... {names[-1]}"
