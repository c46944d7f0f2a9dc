"""Solvers by other people behind one interface, each an optional package, for scores on the suite.

A solver gets the conic program of ``suite_program`` and answers with x, the multipliers z of A x + slack = b, and what
it claims. Its own almost solved counts as said so. Settings are its defaults, tight ones, with which most solvers still
answer most problems, or the tightest, with which they say more often that they failed.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec
from typing import Any, Literal, NamedTuple

import numpy as np

from jaxgrasp.testing.suite_problem import Answer, Claim, SuiteProblem
from jaxgrasp.testing.suite_program import Program, conic_program
from jaxgrasp.validation.optional_library import optional_library

Settings = Literal["default", "tight", "tightest"]
TIGHT, TIGHTEST = 1e-10, 1e-12
STEPS = 1000
"""Largest number of steps of interior-point methods at the tightest settings."""
SPLITTING_STEPS = 100_000
"""Likewise of operator splitting."""


class RawAnswer(NamedTuple):
    """Answer of a solver in the program's own variables."""

    claim: Claim
    x: np.ndarray | None
    z: np.ndarray | None
    """Multipliers of A x + slack = b; those of the six equations are enough."""
    text: str


@dataclass(frozen=True)
class ConicSolver:
    """A solver that is called once for each problem."""

    name: str
    package: str
    """Distribution to install."""
    module: str
    licence: str
    tolerances: dict[str, float]
    """Tolerance that each of the settings asks for."""
    solve_program: Callable[[Program, float, bool], RawAnswer]
    """Takes program, tolerance, and whether settings are other than the defaults."""

    def is_installed(self) -> bool:
        """Return whether its module can be found; nothing is imported."""
        return find_spec(self.module) is not None

    def solve_all(
        self, problems: Sequence[SuiteProblem], settings: Settings = "default", *, is_scaled: bool = True
    ) -> list[Answer]:
        """Solve the problems one after another; an exception of the solver is a failure that it reports.

        Raises:
            ImportError: where it is not installed, with the pip command.
            ValueError: where it has no licence.
        """
        optional_library(self.module, missing=f"{self.module} is not installed: pip install {self.package}")
        return [self._solve(problem, settings, is_scaled) for problem in problems]

    def _solve(self, problem: SuiteProblem, settings: Settings, is_scaled: bool) -> Answer:
        program = conic_program(problem, is_scaled=is_scaled)
        started = time.perf_counter()
        try:
            raw = self.solve_program(program, self.tolerances[settings], settings != "default")
        except Exception as error:
            if "license" in str(error).lower():
                raise ValueError(f"{self.name}: {str(error).strip()}") from error
            # Whatever else a solver raises is its way to say that it failed.
            return Answer(Claim.FAILED, seconds=time.perf_counter() - started, text=f"{type(error).__name__}: {error}")
        seconds = time.perf_counter() - started
        if raw.claim is Claim.SOLVED and raw.x is not None:
            forces, moments = program.forces(raw.x)
            return Answer(raw.claim, forces, moments, None, seconds, raw.text)
        if raw.claim is Claim.INFEASIBLE:
            certificate = None if raw.z is None else program.certificate(raw.z)
            return Answer(raw.claim, None, None, certificate, seconds, raw.text)
        return Answer(Claim.FAILED, seconds=seconds, text=raw.text)


def _claim(status: object, solved: object, infeasible: object) -> Claim:
    return Claim.SOLVED if status == solved else Claim.INFEASIBLE if status == infeasible else Claim.FAILED


def _clarabel(program: Program, tolerance: float, is_tight: bool) -> RawAnswer:
    import clarabel

    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = tolerance
    if is_tight:
        settings.tol_infeas_abs = settings.tol_infeas_rel = tolerance
        settings.max_iter = STEPS
    kinds = [clarabel.ZeroConeT(program.n_zero)]
    kinds += [clarabel.NonnegativeConeT(program.n_nonnegative)] if program.n_nonnegative else []
    kinds += [clarabel.SecondOrderConeT(size) for size in program.cone_sizes]
    answer = clarabel.DefaultSolver(
        program.quadratic, program.linear, program.matrix, program.bound, kinds, settings
    ).solve()
    status = clarabel.SolverStatus
    claim = _claim(answer.status, status.Solved, status.PrimalInfeasible)
    return RawAnswer(claim, np.array(answer.x), np.array(answer.z), str(answer.status))


def _epigraph(program: Program) -> tuple[np.ndarray, Any, np.ndarray, list[int]]:
    """Return cost, rows and bounds of the cones, and their sizes, of the program with a linear objective.

    The last variable t is at least the length of F x + c, whose square is the objective: it has the same minimiser.
    """
    from scipy import sparse

    size = program.matrix.shape[1]
    root, shift = program.cost_root()
    norm_rows = sparse.csc_matrix(np.block([[np.zeros((1, size)), -np.ones((1, 1))], [-root, np.zeros((size, 1))]]))
    below = program.matrix[program.n_zero :]
    wide = sparse.hstack([below, sparse.csc_matrix((below.shape[0], 1))])
    bound = np.concatenate([program.bound[program.n_zero :], [0.0], shift])
    cost = np.append(np.zeros(size), 1.0)
    return cost, sparse.csc_matrix(sparse.vstack([wide, norm_rows])), bound, [*program.cone_sizes, size + 1]


def _ecos(program: Program, tolerance: float, is_tight: bool) -> RawAnswer:
    import ecos
    from scipy import sparse

    cost, rows, bound, sizes = _epigraph(program)
    equal = sparse.csc_matrix(sparse.hstack([program.matrix[: program.n_zero], sparse.csc_matrix((program.n_zero, 1))]))
    options = {"max_iters": STEPS} if is_tight else {}
    answer = ecos.solve(
        cost, rows, bound, {"l": program.n_nonnegative, "q": sizes}, equal, program.bound[: program.n_zero],
        verbose=False, abstol=tolerance, reltol=tolerance, feastol=tolerance, **options,
    )  # fmt: skip
    info = answer["info"]
    return RawAnswer(_claim(info["exitFlag"], 0, 1), answer["x"][:-1], answer["y"], info["infostring"])


def _scs(program: Program, tolerance: float, is_tight: bool) -> RawAnswer:
    import scs

    data = {"P": program.quadratic, "A": program.matrix, "b": program.bound, "c": program.linear}
    cones = {"z": program.n_zero, "l": program.n_nonnegative, "q": list(program.cone_sizes)}
    options = {"max_iters": SPLITTING_STEPS, "eps_infeas": tolerance} if is_tight else {}
    answer = scs.SCS(data, cones, eps_abs=tolerance, eps_rel=tolerance, verbose=False, **options).solve()
    claim = _claim(answer["info"]["status_val"], scs.SOLVED, scs.INFEASIBLE)
    return RawAnswer(claim, answer["x"], answer["y"], answer["info"]["status"])


def _qoco(program: Program, tolerance: float, is_tight: bool) -> RawAnswer:
    import qoco
    from scipy import sparse

    solver = qoco.QOCO()
    equal, below = (sparse.csc_matrix(part) for part in np.split(program.matrix.toarray(), [program.n_zero]))
    options = {"max_iters": STEPS} if is_tight else {}
    solver.setup(
        program.matrix.shape[1], below.shape[0], program.n_zero, program.quadratic, program.linear, equal,
        program.bound[: program.n_zero], below, program.bound[program.n_zero :], program.n_nonnegative,
        len(program.cone_sizes), np.array(program.cone_sizes, int), abstol=tolerance, reltol=tolerance, verbose=0,
        **options,
    )  # fmt: skip
    answer = solver.solve()
    # It does not detect infeasibility.
    claim = Claim.SOLVED if answer.status == "QOCO_SOLVED" else Claim.FAILED
    return RawAnswer(claim, np.array(answer.x), None, str(answer.status))


def _moreau(program: Program, tolerance: float, is_tight: bool) -> RawAnswer:
    import moreau

    rows = program.matrix.tocsr()
    quadratic = program.quadratic.tocsr()
    cones = moreau.Cones(
        num_zero_cones=program.n_zero, num_nonneg_cones=program.n_nonnegative, so_cone_dims=list(program.cone_sizes)
    )
    options = {"max_iter": STEPS} if is_tight else {}
    inner = moreau.IPMSettings(tol_gap_abs=tolerance, tol_gap_rel=tolerance, tol_feas=tolerance)
    settings = moreau.Settings(solver="ipm", device="cpu", batch_size=1, ipm_settings=inner, **options)
    solver = moreau.CompiledSolver(
        rows.shape[1], rows.shape[0], quadratic.indptr, quadratic.indices, rows.indptr, rows.indices, cones=cones,
        settings=settings,
    )  # fmt: skip
    solver.setup(quadratic.data[None], rows.data[None])
    answer = solver.solve(program.linear[None], program.bound[None])
    status = solver.info.status[0]
    claim = _claim(status, moreau.SolverStatus.Solved, moreau.SolverStatus.PrimalInfeasible)
    return RawAnswer(claim, np.asarray(answer.x)[0], np.asarray(answer.z)[0], str(status))


def _cvxopt(program: Program, tolerance: float, is_tight: bool) -> RawAnswer:
    from cvxopt import matrix, solvers, spmatrix

    def sparse(part: Any) -> Any:
        part = part.tocoo()
        return spmatrix(part.data.tolist(), part.row.tolist(), part.col.tolist(), part.shape, "d")

    options: dict[str, Any] = {"show_progress": False}
    if is_tight:
        options |= {"abstol": tolerance, "reltol": tolerance, "feastol": tolerance}
    cost, rows, bound, sizes = _epigraph(program)
    # conelp detects infeasibility, which coneqp does not.
    equal = program.matrix[: program.n_zero].toarray()
    equal = np.concatenate([equal, np.zeros((program.n_zero, 1))], 1)
    answer = solvers.conelp(
        matrix(cost), sparse(rows), matrix(bound), {"l": program.n_nonnegative, "q": sizes, "s": []}, matrix(equal),
        matrix(program.bound[: program.n_zero]), options=options,
    )  # fmt: skip
    claim = _claim(answer["status"], "optimal", "primal infeasible")
    x, y = (None if answer[key] is None else np.array(answer[key]).ravel() for key in ("x", "y"))
    return RawAnswer(claim, None if x is None else x[:-1], y, str(answer["status"]))


def _gurobi(program: Program, tolerance: float, is_tight: bool) -> RawAnswer:
    import gurobipy as gp

    with gp.Env(params={"OutputFlag": 0}) as environment, gp.Model(env=environment) as model:
        x = model.addMVar(program.matrix.shape[1], lb=-gp.GRB.INFINITY)
        model.setObjective(0.5 * (x @ program.quadratic @ x) + program.linear @ x)
        zero, linear = program.n_zero, program.n_zero + program.n_nonnegative
        model.addConstr(program.matrix[:zero] @ x == program.bound[:zero])
        if linear > zero:
            model.addConstr(program.matrix[zero:linear] @ x <= program.bound[zero:linear])
        first = linear
        for size in program.cone_sizes:
            slack = model.addMVar(size, lb=np.array([0.0] + [-gp.GRB.INFINITY] * (size - 1)))
            rows = slice(first, first + size)
            model.addConstr(program.matrix[rows] @ x + slack == program.bound[rows])
            model.addConstr(slack[1:] @ slack[1:] <= slack[0] * slack[0])
            first += size
        # Without dual reductions it tells infeasible from unbounded problems.
        model.setParam("DualReductions", 0)
        if is_tight:
            model.setParam("BarQCPConvTol", tolerance)
            model.setParam("FeasibilityTol", 1e-9)
            model.setParam("OptimalityTol", 1e-9)
            model.setParam("NumericFocus", 3)
        model.optimize()
        claim = _claim(model.Status, gp.GRB.OPTIMAL, gp.GRB.INFEASIBLE)
        return RawAnswer(claim, x.X if claim is Claim.SOLVED else None, None, f"status {model.Status}")


def _mosek(program: Program, tolerance: float, is_tight: bool) -> RawAnswer:
    import mosek

    cost, rows, bound, sizes = _epigraph(program)
    size, linear = len(cost), program.n_zero + program.n_nonnegative
    equal = np.concatenate([program.matrix[: program.n_zero].toarray(), np.zeros((program.n_zero, 1))], 1)
    below = rows.toarray()
    with mosek.Env() as environment, environment.Task() as task:
        task.appendvars(size)
        task.putvarboundsliceconst(0, size, mosek.boundkey.fr, 0.0, 0.0)
        task.putclist(list(range(size)), cost.tolist())
        task.appendcons(linear)
        matrix = np.concatenate([equal, below[: program.n_nonnegative]])
        for i in range(linear):
            used = np.flatnonzero(matrix[i])
            task.putarow(i, used.tolist(), matrix[i, used].tolist())
            key = mosek.boundkey.fx if i < program.n_zero else mosek.boundkey.up
            value = program.bound[i]
            task.putconbound(i, key, value, value)
        cones = below[program.n_nonnegative :]
        shift = bound[program.n_nonnegative :]
        task.appendafes(len(cones))
        for i, row in enumerate(cones):
            used = np.flatnonzero(row)
            task.putafefrow(i, used.tolist(), (-row[used]).tolist())
            task.putafeg(i, float(shift[i]))
        first = 0
        for cone in sizes:
            domain = task.appendquadraticconedomain(cone)
            task.appendacc(domain, list(range(first, first + cone)), [0.0] * cone)
            first += cone
        if is_tight:
            for name in ("intpnt_co_tol_pfeas", "intpnt_co_tol_dfeas", "intpnt_co_tol_rel_gap", "intpnt_co_tol_infeas"):
                task.putdouparam(getattr(mosek.dparam, name), tolerance)
        task.optimize()
        status = task.getsolsta(mosek.soltype.itr)
        claim = _claim(status, mosek.solsta.optimal, mosek.solsta.prim_infeas_cer)
        x = np.array(task.getxx(mosek.soltype.itr))[:-1] if claim is Claim.SOLVED else None
        z = None
        if claim is Claim.INFEASIBLE:
            # MOSEK's multipliers of G f = w have the opposite sign of ours.
            z = -np.array(task.gety(mosek.soltype.itr))[: program.n_zero]
        return RawAnswer(claim, x, z, str(status))


def _tolerances(default: float, tight: float = TIGHT, tightest: float = TIGHTEST) -> dict[str, float]:
    return {"default": default, "tight": tight, "tightest": tightest}


SOLVERS = {
    solver.name: solver
    for solver in (
        ConicSolver("clarabel", "clarabel", "clarabel", "Apache-2.0", _tolerances(1e-8), _clarabel),
        ConicSolver("ecos", "ecos", "ecos", "GPL-3.0", _tolerances(1e-8), _ecos),
        ConicSolver("scs", "scs", "scs", "MIT", _tolerances(1e-4, 1e-6, 1e-9), _scs),
        ConicSolver("qoco", "qoco", "qoco", "BSD-3-Clause", _tolerances(1e-7), _qoco),
        ConicSolver("moreau", "moreau", "moreau", "Apache-2.0", _tolerances(1e-8), _moreau),
        ConicSolver("cvxopt", "cvxopt", "cvxopt", "GPL-3.0", _tolerances(1e-7, 1e-8, 1e-9), _cvxopt),
        ConicSolver("gurobi", "gurobipy", "gurobipy", "commercial", _tolerances(1e-6), _gurobi),
        ConicSolver("mosek", "mosek", "mosek", "commercial", _tolerances(1e-8), _mosek),
    )
}
"""Solvers by name."""


class FunctionSolver:
    """A function ``problem -> Answer`` of the user's own, named as ``module:function``."""

    def __init__(self, name: str) -> None:
        """Import the function.

        Raises:
            ValueError: where the module has no such function.
            ImportError: where there is no such module.
        """
        module, _, function = name.partition(":")
        self.name = name
        solve = getattr(import_module(module), function, None)
        if not callable(solve):
            raise ValueError(f"solver is {name!r}: {module} has no function {function!r}")
        self._solve: Callable[[SuiteProblem], Any] = solve

    def solve_all(self, problems: Sequence[SuiteProblem]) -> list[Answer]:
        """Solve the problems one after another; exceptions are the function's own."""
        answers = []
        for problem in problems:
            started = time.perf_counter()
            answer = self._solve(problem)
            if not isinstance(answer, Answer):
                raise ValueError(
                    f"{self.name} returned {type(answer).__name__}: expected jaxgrasp.testing.suite.Answer"
                )
            answers.append(answer._replace(seconds=time.perf_counter() - started))
        return answers
