"""Command ``jaxgrasp suite``: export of the hard problems, and the score of a solver on them."""

from collections.abc import Sequence
from pathlib import Path

from jaxgrasp.cli.arguments import OWN_SOLVERS, ExportSuite, ListSuite, RunSuite
from jaxgrasp.cli.terminal import show
from jaxgrasp.files.replace import replace_file
from jaxgrasp.testing.suite import (
    KINDS,
    OUTCOMES,
    VERSION,
    Answer,
    Score,
    SuiteProblem,
    counts,
    csv_text,
    judged_tolerance,
    load_suite,
    median_seconds,
    score,
)
from jaxgrasp.testing.suite_files import write_cbf, write_npz, write_qps
from jaxgrasp.testing.suite_solvers import SOLVERS, FunctionSolver


def list_command(arguments: ListSuite) -> int:
    """Print each kind with its number of problems and what makes it hard, and the solvers."""
    problems = load_suite()
    show(f"version {VERSION}: {len(problems)} problems, {sum(not p.feasible for p in problems)} of them infeasible")
    for kind, text in KINDS.items():
        show(f"{kind:16s} {sum(p.kind == kind for p in problems):4d}  {text}")
    for solver in SOLVERS.values():
        state = "installed" if solver.is_installed() else f"not installed: pip install {solver.package}"
        show(f"solver {solver.name}: {state}")
    show(f"solvers of this package: {', '.join(OWN_SOLVERS)}")
    return 0


def export_command(arguments: ExportSuite) -> int:
    """Write the problems in a format, and say what was left out."""
    problems = load_suite(arguments.kinds)
    if arguments.format == "npz":
        arguments.out.mkdir(parents=True, exist_ok=True)
        path = arguments.out / "grasp-suite.npz"
        write_npz(path, problems)
        show(f"{path}: {len(problems)} problems with references")
    elif arguments.format == "cbf":
        write_cbf(arguments.out, problems, is_scaled=arguments.scaled)
        show(f"{arguments.out}: {len(problems)} files .cbf, and index.csv")
    else:
        left_out = write_qps(arguments.out, problems, sides=arguments.sides, is_scaled=arguments.scaled)
        show(f"{arguments.out}: {len(problems) - len(left_out)} files .npz of quadratic programs")
        if left_out:
            show(f"left out, since soft fingers have no pyramids: {', '.join(left_out)}")
    return 0


def run_command(arguments: RunSuite) -> int:
    """Solve, score, and print counts by kind; return 1 if an answer is wrong in silence or calls infeasible solved."""
    problems = load_suite(arguments.kinds)
    answers, tolerance = _answers(arguments, problems)
    if arguments.tolerance is not None:
        tolerance = arguments.tolerance
    if not 0 < tolerance < 1:
        raise ValueError(f"tolerance is {tolerance}: expected more than 0 and less than 1")
    scores = [score(problem, answer, tolerance) for problem, answer in zip(problems, answers, strict=True)]
    show(f"{arguments.solver}, version {VERSION} of the suite, errors of right answers at most {tolerance:g}")
    _show_counts(scores)
    if arguments.out is not None:
        path: Path = arguments.out
        replace_file(path, lambda stream: stream.write(csv_text(scores).encode()))
        show(f"{path}: a row for each problem")
    totals = counts(scores)
    return int(totals["wrong in silence"] + totals["infeasible called solved"] > 0)


def _answers(arguments: RunSuite, problems: Sequence[SuiteProblem]) -> tuple[list[Answer], float]:
    """Return the solver's answers, and the largest error of a right one."""
    name = arguments.solver
    if name in SOLVERS:
        solver = SOLVERS[name]
        answers = solver.solve_all(problems, arguments.settings, is_scaled=arguments.scaled)
        return answers, judged_tolerance(solver.tolerances[arguments.settings])
    if name in OWN_SOLVERS:
        # JAX is imported for this package's own solver alone.
        from jaxgrasp.cli.machine import set_up_jax
        from jaxgrasp.cli.suite_solver import OwnSolver

        set_up_jax("float32" if "float32" in name else "float64")
        own = OwnSolver(name)
        return own.solve_all(problems), judged_tolerance(own.tolerance)
    if ":" in name:
        return FunctionSolver(name).solve_all(problems), judged_tolerance(0.0)
    raise ValueError(f"solver is {name!r}: expected one of {', '.join([*OWN_SOLVERS, *SOLVERS])}, or module:function")


def _show_counts(scores: Sequence[Score]) -> None:
    kinds = list(dict.fromkeys(score.kind for score in scores))
    show(f"{'kind':16s} " + " ".join(f"{outcome.value:>26s}" for outcome in OUTCOMES))
    for kind in [*kinds, "all"]:
        totals = counts([score for score in scores if kind in (score.kind, "all")])
        show(f"{kind:16s} " + " ".join(f"{totals[outcome.value]:26d}" for outcome in OUTCOMES))
    totals = counts(scores)
    show(
        f"of these, forces that solve a problem nearby: {totals['wrong, nearby']} of the wrong, "
        f"{totals['infeasible solved, nearby']} of the infeasible called solved"
    )
    show(f"median time of a problem: {median_seconds(scores) * 1e6:.3g} microseconds")
