"""Arguments of ``jaxgrasp evaluate``."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import tyro

from jaxgrasp.cli.data_arguments import Convention

MethodName = Literal["A", "B", "A-optimum", "B-optimum"]


@dataclass(frozen=True)
class Evaluate(Convention):
    """Compute closed forms and constrained optima of every grasp, sum them up, and write results and a report."""

    file: tyro.conf.Positional[tuple[str, ...]] = ()
    """A file of grasps (.npz, .csv, .parquet, .h5); the simulated grips that ship with the package where not given.
    With --cluster any number of Parquet files, or folders of them; of an object store too, by address:
    s3://bucket/folder/*.parquet."""
    methods: tuple[MethodName, ...] = ("A", "B", "A-optimum", "B-optimum")
    """Methods to compute: method A (eq. 11), B (eq. 15), and their optima with friction imposed."""
    quality: str = ""
    """Measures of the grasps whatever they hold, with commas between them: force-closure, ferrari-canny-l1,
    ferrari-canny-linf, min-weight, least-singular-value, volume, isotropy; with --task also task-ball-l1,
    task-ball-linf, task-margin, hold-probability. Balls cost up to a second a grasp."""
    task: Path | None = None
    """A TOML file of a task's demands on the grasps, for the measures of quality of a task: wrenches, an ellipsoid of
    disturbances, uncertainty."""
    friction: tuple[float, ...] = ()
    """Friction for all contacts, in place of the file's; several values are evaluated one after another."""
    squeeze: tuple[float, ...] = ()
    """Squeezing force for all contacts [N], in place of the file's; several values likewise."""
    torsion: float | None = None
    """Torsional friction of all contacts [m], in place of the file's: soft fingers, which resist some torque about
    their normals, as wide pads do. A pad's torsional friction is about its friction times 2/3 of its radius."""
    least_friction: bool = False
    """Find the least factor on its friction with which each grasp holds, if its normal forces together are its squeeze:
    above 1 it has to press harder. Costs about half a millisecond a grasp and wrench."""
    table: Literal["auto", "csv", "parquet", "none"] = "auto"
    """A table beside the results, one row for each grasp and wrench: auto writes results.csv up to 100,000 rows.
    Parquet, which holds the forces too, needs the extra `table`."""
    out: Path = Path("jaxgrasp-results")
    """Folder for the results; it gets one sub-folder a value where values are swept."""
    chunk: int = 16_384
    """Grasps that each core works on at a time."""
    dtype: Literal["float64", "float32"] = "float64"
    """Precision of the arithmetic."""
    skip_bad: bool = False
    """Set bad grasps aside and count them, instead of stopping at the first."""
    resume: bool = False
    """Go on with an interrupted evaluation in the same folder; files of results that are damaged are computed again."""
    overwrite: bool = False
    """Replace the results of another evaluation in the folder; without this option they stay, and are an error."""
    details: bool = False
    """Also print the statistics of each method: verdicts, times, the price of friction, distances in force."""
    report: bool = True
    """Write report.html beside the results (needs the extra `report`)."""
    cluster: str | None = None
    """Evaluate many Parquet files, each by some process of a cluster of Ray (extra `cluster`): `local` starts one on
    this machine, `auto` takes the one that runs here or that RAY_ADDRESS names, anything else is its address. Writes a
    Parquet file of results for each, by its own name."""
    workers: int | None = None
    """With --cluster: processes, of one core each; all cores of the cluster where not given."""
    gpus: float = 0.0
    """With --cluster: GPUs of each process."""
    skip_damaged: bool = False
    """With --cluster: name files that are damaged or hold bad grasps, and go on with the others."""
