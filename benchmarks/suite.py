"""Scores of every solver on the suite of hard problems: right, wrong in silence, said so, proven, and time.

    python -m benchmarks.suite --out benchmarks/results

Writes suite.json and suite.md. Solvers that are not installed are left out, by name; commercial ones too, since their
licences do not let results be published: ``jaxgrasp suite run --solver gurobi`` scores one for yourself.
"""

from benchmarks.one_thread import one_thread

one_thread()

from collections.abc import Iterable
from typing import Any, NamedTuple

from benchmarks.page import suite_tables
from benchmarks.rivals.registry import versions
from benchmarks.sections import run_sections
from jaxgrasp.cli.arguments import OWN_SOLVERS
from jaxgrasp.kernel import is_installed
from jaxgrasp.testing.suite import (
    KINDS,
    VERSION,
    Answer,
    SuiteProblem,
    counts,
    judged_tolerance,
    load_suite,
    median_seconds,
    score,
)
from jaxgrasp.testing.suite_solvers import SOLVERS, Settings

NAME = "suite"


class Plan(NamedTuple):
    kinds: tuple[str, ...] = ()
    solvers: tuple[str, ...] = (*OWN_SOLVERS, *(name for name, s in SOLVERS.items() if s.licence != "commercial"))


QUICK = Plan(kinds=("two_fingers", "zero_friction"), solvers=("jaxgrasp", "clarabel"))


def scores(plan: Plan) -> dict:
    """Score each solver at its settings, on scaled problems and on raw ones."""
    problems = load_suite(plan.kinds)
    rows, missing = [], []
    for name in plan.solvers:
        if name in SOLVERS:
            if not SOLVERS[name].is_installed():
                missing.append(
                    f"{name} is not installed, so its rows are left out: pip install {SOLVERS[name].package}"
                )
                continue
            cases = [(settings, is_scaled) for settings in SOLVERS[name].tolerances for is_scaled in (True, False)]
            rows += [outside_row(name, settings, is_scaled, problems) for settings, is_scaled in cases]
        elif "kernel" in name and not is_installed():
            missing.append(f"{name} is left out: pip install 'jaxgrasp[kernel]'")
        else:
            # Late, so that JAX's threads do not run beside the other solvers.
            import jax

            from jaxgrasp.cli.suite_solver import OwnSolver

            jax.config.update("jax_enable_x64", True)
            own = OwnSolver(name)
            facts = {"settings": "its own", "scaled": None, "licence": "Apache-2.0"}
            rows.append(facts | _row(name, own.tolerance, problems, own.solve_all(problems)))
    packages = [SOLVERS[name].package for name in plan.solvers if name in SOLVERS]
    return {
        "version": VERSION,
        "problems": len(problems),
        "infeasible": sum(not problem.feasible for problem in problems),
        "kinds": {kind: _facts(problem for problem in problems if problem.kind == kind) for kind in KINDS},
        "packages": versions(packages),
        "missing": missing,
        "rows": rows,
    }


def outside_row(name: str, settings: Settings, is_scaled: bool, problems: tuple[SuiteProblem, ...]) -> dict:
    """Score a solver by other people at one of its settings."""
    solver = SOLVERS[name]
    answers = solver.solve_all(problems, settings, is_scaled=is_scaled)
    facts = {"settings": settings, "scaled": is_scaled, "licence": solver.licence}
    return facts | _row(name, solver.tolerances[settings], problems, answers)


def _facts(problems: Iterable[SuiteProblem]) -> dict:
    chosen = list(problems)
    sizes = sorted({len(problem.friction) for problem in chosen})
    return {"problems": len(chosen), "infeasible": sum(not p.feasible for p in chosen), "sizes": sizes}


def _row(name: str, tolerance: float, problems: tuple[SuiteProblem, ...], answers: list[Answer]) -> dict[str, Any]:
    judged = judged_tolerance(tolerance)
    judgements = [score(problem, answer, judged) for problem, answer in zip(problems, answers, strict=True)]
    solved = [s.errors for s in judgements if s.outcome == "right" and s.errors is not None]
    return {
        "solver": name,
        "tolerance": tolerance,
        "judged": judged,
        "counts": counts(judgements),
        "kinds": {
            kind: counts([s for s in judgements if s.kind == kind])
            for kind in dict.fromkeys(s.kind for s in judgements)
        },
        "microseconds": median_seconds(judgements) * 1e6,
        "worst_objective": max((e.objective for e in solved), default=None),
        "worst_force": max((e.forces for e in solved), default=None),
        "wrong": [s.problem for s in judgements if s.outcome in ("wrong in silence", "infeasible called solved")],
        "said_so": [s.problem for s in judgements if s.outcome == "said so"],
    }


SECTIONS = {"scores": scores}


def main() -> None:
    run_sections(__doc__, NAME, SECTIONS, (Plan(), QUICK), suite_tables.page)


if __name__ == "__main__":
    main()
