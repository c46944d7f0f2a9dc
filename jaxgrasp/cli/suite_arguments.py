"""Arguments of ``jaxgrasp suite``."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

OWN_SOLVERS = (
    *("jaxgrasp", "jaxgrasp-last-resort", "jaxgrasp-float32"),
    *("jaxgrasp-kernel", "jaxgrasp-kernel-last-resort", "jaxgrasp-kernel-float32"),
)
"""Names of this package's own solver."""


@dataclass(frozen=True)
class ListSuite:
    """List the kinds of problems, what makes each hard, and the solvers that are installed."""


@dataclass(frozen=True)
class ExportSuite:
    """Write the suite's problems for other programs."""

    format: Literal["cbf", "npz", "qps"] = "cbf"
    """cbf: a file of the Conic Benchmark Format for each problem, and index.csv with the answers. npz: one file with
    data and references. qps: quadratic programs with pyramids for cones, a .npz for each in qpbenchmark's layout."""
    out: Path = Path("grasp-suite")
    """Folder to write; the file grasp-suite.npz in it for npz."""
    kinds: tuple[str, ...] = ()
    """Kinds of problems; all where not given."""
    scaled: bool = False
    """Centre and scale the problems first, as solvers like them, instead of newtons and metres in the user's frame."""
    sides: int = 8
    """Sides of the pyramids of qps."""


@dataclass(frozen=True)
class RunSuite:
    """Solve the suite's problems by a solver, and score its answers against the references."""

    solver: str = "jaxgrasp"
    """jaxgrasp, or jaxgrasp-kernel for the compiled kernel, both also with -float32 or -last-resort behind; clarabel,
    ecos, scs, qoco, moreau, cvxopt, gurobi, mosek; or module:function, which takes a SuiteProblem and returns an Answer
    of jaxgrasp.testing.suite."""
    settings: Literal["default", "tight", "tightest"] = "default"
    """The solver's defaults; tight ones, with which most solvers still answer most problems; or the tightest, with
    which they say more often that they failed. jaxgrasp has no settings."""
    scaled: bool = True
    """Centre and scale the problems first; jaxgrasp and your own function get the data as they are."""
    kinds: tuple[str, ...] = ()
    """Kinds of problems; all where not given."""
    tolerance: float | None = None
    """Largest error of a right answer in balance, cones and objective; 100 times the solver's own tolerance, and at
    least 1e-6, where not given."""
    out: Path | None = None
    """CSV file to write, with a row for each problem."""


@dataclass(frozen=True)
class SuiteCommand:
    """Hard problems with references in extended precision, for people who write cone solvers."""

    command: tyro.conf.OmitSubcommandPrefixes[
        tyro.conf.OmitArgPrefixes[
            Annotated[ExportSuite, tyro.conf.subcommand("export")]
            | Annotated[ListSuite, tyro.conf.subcommand("list")]
            | Annotated[RunSuite, tyro.conf.subcommand("run")]
        ]
    ]
