"""Laws of the suite: references prove themselves in exact arithmetic, and scores tell right from wrong."""

import hashlib
import warnings

import numpy as np
import pytest

import jaxgrasp
from jaxgrasp import Grasp
from jaxgrasp.cli.main import main
from jaxgrasp.testing import suite as S
from jaxgrasp.testing import suite_files as F
from jaxgrasp.testing.suite import judged_tolerance
from jaxgrasp.testing.suite_judge import judge, proves
from jaxgrasp.testing.suite_program import conic_program, pyramid_program
from jaxgrasp.testing.suite_solvers import SOLVERS, ConicSolver

PROBLEMS = S.load_suite()
FEASIBLE = [problem for problem in PROBLEMS if problem.feasible]
INFEASIBLE = [problem for problem in PROBLEMS if not problem.feasible]
FEW = tuple(next(p for p in PROBLEMS if p.kind == kind) for kind in S.KINDS)
"""One of each kind."""


def digest() -> str:
    """Return the digest of all data and references, whatever the compression of the file."""
    text = hashlib.sha256()
    for problem in PROBLEMS:
        text.update(problem.name.encode())
        for value in problem:
            if isinstance(value, np.ndarray):
                text.update(np.ascontiguousarray(value, "<f8").tobytes())
    return text.hexdigest()


def test_a_version_never_changes():
    assert (S.VERSION, digest()) == ("1", "40a1b637924f726cf8cc61ad6f541bfbb7c9d6bdc65bbdeeb68a213e5f7b43a5")
    assert S.FILE.stat().st_size < 5e6


def test_kinds_and_names():
    assert list(dict.fromkeys(p.kind for p in sorted(PROBLEMS, key=lambda p: list(S.KINDS).index(p.kind)))) == [
        *S.KINDS
    ]
    assert len({problem.name for problem in PROBLEMS}) == len(PROBLEMS)
    shares = {p.distance for p in PROBLEMS if p.kind in ("inside_limit", "outside_limit")}
    assert shares == {10.0**-k for k in range(1, 9)}


def test_references_prove_themselves():
    """By weak duality, in 100 digits: allowed, balancing forces and a multiplier whose value is their cost."""
    for problem in FEASIBLE:
        assert max(judge(problem)) < 1e-20, problem.name


def test_certificates_prove_themselves_in_rational_arithmetic():
    for problem in INFEASIBLE:
        assert proves(problem), problem.name
        assert not proves(problem, -problem.certificate), problem.name


def test_the_judge_sees_a_wrong_reference():
    """A change in the 19th digit of a force shows."""
    problem = FEASIBLE[0]
    changed = problem.forces.copy()
    changed[1] += 1e-18 * np.abs(problem.forces[0]).max()
    assert max(judge(problem._replace(forces=changed))) > 1e-20
    assert max(judge(problem._replace(multiplier=problem.multiplier * (1 + 1e-9)))) > 1e-20


def test_data_are_those_of_grasps():
    for problem in PROBLEMS:
        grasp = Grasp(problem.points, problem.normals, problem.friction, problem.squeeze, torsion=problem.torsion)
        with warnings.catch_warnings():
            # Normals that point away from the centre are part of some kinds.
            warnings.simplefilter("ignore", UserWarning)
            jaxgrasp.check_grasp(grasp)


def answer(problem: S.SuiteProblem) -> S.Answer:
    """Return the reference, rounded, as an answer."""
    if problem.feasible:
        return S.Answer(S.Claim.SOLVED, problem.forces[0], problem.moments[0])
    return S.Answer(S.Claim.INFEASIBLE, certificate=problem.certificate[0])


@pytest.mark.parametrize("tolerance", [1e-6, 1e-10])
def test_rounded_references_are_right(tolerance):
    """So float64 can hold an answer to each problem, and a proof where there is none."""
    for problem in PROBLEMS:
        outcome = S.score(problem, answer(problem), tolerance).outcome
        assert outcome is (S.Outcome.RIGHT if problem.feasible else S.Outcome.PROVEN), problem.name


def test_wrong_answers_are_seen():
    feasible = next(p for p in FEASIBLE if p.kind == "ordinary")
    infeasible = INFEASIBLE[0]
    right = answer(feasible)
    heavy = right._replace(forces=1.001 * right.forces)
    assert S.score(feasible, heavy).outcome is S.Outcome.WRONG and not S.score(feasible, heavy).is_nearby
    # Forces that balance and are allowed, but cost more.
    pinched = next(p for p in FEASIBLE if p.name == "published_antipodal_pair")
    squeezed = answer(pinched)._replace(forces=pinched.forces[0] + 3 * np.array([[-1.0, 0, 0], [1, 0, 0]]))
    judged = S.score(pinched, squeezed)
    assert judged.outcome is S.Outcome.WRONG and judged.is_nearby
    assert S.score(feasible, S.Answer(S.Claim.INFEASIBLE)).outcome is S.Outcome.WRONG
    assert S.score(feasible, S.Answer(S.Claim.SOLVED, np.full_like(right.forces, np.nan))).outcome is S.Outcome.WRONG
    assert S.score(feasible, S.Answer(S.Claim.FAILED)).outcome is S.Outcome.SAID_SO
    solved = S.Answer(S.Claim.SOLVED, np.zeros((len(infeasible.friction), 3)))
    assert S.score(infeasible, solved).outcome is S.Outcome.INFEASIBLE_SOLVED
    backwards = S.Answer(S.Claim.INFEASIBLE, certificate=-infeasible.certificate[0])
    assert S.score(infeasible, backwards).outcome is S.Outcome.CLAIMED
    assert S.score(infeasible, S.Answer(S.Claim.INFEASIBLE)).outcome is S.Outcome.CLAIMED


@pytest.mark.parametrize("is_scaled", [True, False])
def test_references_solve_the_conic_programs(is_scaled):
    """The reference's x obeys every row, and its cost is the reference's, in either scaling."""
    for problem in FEW:
        if not problem.feasible:
            continue
        program = conic_program(problem, is_scaled=is_scaled)
        vectors = np.concatenate([problem.forces[0], problem.moments[0][:, None]], -1) - program.offsets
        x = np.linalg.lstsq(program.columns.reshape(-1, program.columns.shape[2]), vectors.ravel())[0]
        root, shift = program.cost_root()
        np.testing.assert_allclose(np.sum((root @ x + shift) ** 2), program.objective(problem), rtol=1e-9, atol=1e-12)
        slack = program.bound - program.matrix @ x
        # Forces are rounded to float64, the squeezing forces among them.
        unit = 1.0 if is_scaled else problem.squeeze.max()
        size = np.abs(program.bound) + abs(program.matrix) @ np.abs(x) + unit
        first = program.n_zero + program.n_nonnegative
        assert np.all(np.abs(slack[: program.n_zero]) <= 1e-13 * size[: program.n_zero].max())
        assert np.all(slack[program.n_zero : first] >= -1e-13 * size[program.n_zero : first])
        for count in program.cone_sizes:
            cone = slice(first, first + count)
            assert slack[first] - np.linalg.norm(slack[first + 1 : first + count]) >= -1e-12 * size[cone].max()
            first += count


def read_cbf(text: str) -> dict:
    """Read what a file of the Conic Benchmark Format holds, by its definition: A x + b in cones."""
    lines = iter([line for line in text.splitlines() if line and not line.startswith("#")])
    blocks: dict = {}
    for keyword in lines:
        if keyword == "VER":
            blocks[keyword] = int(next(lines))
        elif keyword == "OBJSENSE":
            blocks[keyword] = next(lines)
        elif keyword in ("VAR", "CON"):
            _, count = map(int, next(lines).split())
            blocks[keyword] = [(name, int(size)) for name, size in (next(lines).split() for _ in range(count))]
        else:
            blocks[keyword] = [next(lines).split() for _ in range(int(next(lines)))]
    return blocks


@pytest.mark.parametrize("is_scaled", [True, False])
def test_conic_benchmark_files_have_the_reference_as_optimum(folder, is_scaled):
    """What Clarabel finds for a file's own rows is the objective that index.csv names."""
    import clarabel
    from scipy import sparse

    chosen = [
        p for p in FEW if p.kind in ("ordinary", "zero_friction", "soft_fingers", "torque_limits", "idle_contacts")
    ]
    F.write_cbf(folder / "cbf", chosen, is_scaled=is_scaled)
    index = [line.split(",") for line in (folder / "cbf" / "index.csv").read_text().splitlines()[1:]]
    assert [row[0] for row in index] == [problem.name for problem in chosen]
    for problem, row in zip(chosen, index):
        blocks = read_cbf((folder / "cbf" / f"{problem.name}.cbf").read_text())
        assert blocks["VER"] == 3 and blocks["OBJSENSE"] == "MIN"
        ((_, size),) = blocks["VAR"]
        height = sum(count for _, count in blocks["CON"])
        matrix, bound, cost = np.zeros((height, size)), np.zeros(height), np.zeros(size)
        for i, j, value in blocks["ACOORD"]:
            matrix[int(i), int(j)] = float(value)
        for i, value in blocks["BCOORD"]:
            bound[int(i)] = float(value)
        for j, value in blocks["OBJACOORD"]:
            cost[int(j)] = float(value)
        kinds = {"L=": clarabel.ZeroConeT, "L+": clarabel.NonnegativeConeT, "Q": clarabel.SecondOrderConeT}
        settings = clarabel.DefaultSettings()
        settings.verbose = False
        cones = [kinds[name](count) for name, count in blocks["CON"]]
        solved = clarabel.DefaultSolver(
            sparse.csc_matrix((size, size)), cost, sparse.csc_matrix(-matrix), bound, cones, settings
        ).solve()
        assert str(solved.status) == "Solved"
        np.testing.assert_allclose(solved.obj_val, float(row[4]), rtol=1e-5)


def test_pyramids_have_the_layout_of_qpbenchmark(folder):
    left_out = F.write_qps(folder / "qps", FEW)
    assert left_out == [problem.name for problem in FEW if problem.torsion is not None]
    problem = next(p for p in FEW if p.kind == "ordinary")
    n = len(problem.friction)
    with np.load(folder / "qps" / f"{problem.name}.npz") as archive:
        shapes = {name: archive[name].shape for name in ("P", "q", "G", "h", "A", "b")}
    assert shapes == {"P": (3 * n,) * 2, "q": (3 * n,), "G": (9 * n, 3 * n), "h": (9 * n,), "A": (6, 3 * n), "b": (6,)}
    # Inscribed pyramids: what they allow lies inside the cones.
    program = pyramid_program(problem, sides=8, is_scaled=False)
    rng = np.random.default_rng(0)
    force = rng.normal(size=(1000, n, 3)) + 3 * problem.normals
    slack = program.bound[6:] - np.einsum("rx,bx->br", program.matrix.toarray()[6:], force.reshape(1000, -1))
    allowed = (slack.reshape(1000, n, 9) >= 0).all(-1)
    press = np.sum(force * problem.normals, -1)
    across = np.linalg.norm(force - press[..., None] * problem.normals, axis=-1)
    assert 0 < allowed.sum() < allowed.size and (across <= problem.friction * press)[allowed].all()


def test_files_hold_the_same_problems(folder):
    F.write_npz(folder / "suite.npz", FEW)
    for written, read in zip(FEW, S.load_suite(path=folder / "suite.npz"), strict=True):
        for old, new in zip(written, read):
            np.testing.assert_array_equal(old, new)


def test_clarabel_is_scored(folder, capsys):
    assert main(["suite", "run", "--solver", "clarabel", "--kinds", "ordinary", "infeasible", "--out", "s.csv"]) == 0
    printed = capsys.readouterr().out
    assert "right" in printed and "median time" in printed
    rows = (folder / "s.csv").read_text().splitlines()
    assert len(rows) == 1 + sum(p.kind in ("ordinary", "infeasible") for p in PROBLEMS)
    assert all(",right," in row for row in rows if row.startswith("ordinary"))


def says_solved(problem: S.SuiteProblem) -> S.Answer:
    """Claim that the squeezing forces solve every problem."""
    return S.Answer(S.Claim.SOLVED, problem.squeeze[:, None] * problem.normals)


def test_a_function_is_scored(folder, monkeypatch, capsys):
    monkeypatch.syspath_prepend(folder)
    (folder / "bold_solver.py").write_text(
        "from jaxgrasp.testing.suite import Answer, Claim\n"
        "def solve(problem):\n"
        "    return Answer(Claim.SOLVED, problem.squeeze[:, None] * problem.normals)\n"
    )
    assert main(["suite", "run", "--solver", "bold_solver:solve", "--kinds", "ordinary", "infeasible"]) == 1
    (line,) = [line for line in capsys.readouterr().out.splitlines() if line.startswith("all ")]
    count = {kind: sum(p.kind == kind for p in PROBLEMS) for kind in ("ordinary", "infeasible")}
    assert list(map(int, line.split()[1:])) == [0, count["ordinary"], 0, 0, 0, count["infeasible"]]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["run", "--solver", "nobody"], "solver is 'nobody': expected one of jaxgrasp, "),
        (["run", "--solver", "json:nothing"], "json has no function 'nothing'"),
        (["run", "--solver", "clarabel", "--kinds", "easy"], "kind is 'easy': expected one of ordinary, "),
        (["run", "--solver", "clarabel", "--kinds", "two_fingers", "--tolerance", "2"], "tolerance is 2.0: expected"),
        (["export", "--format", "qps", "--sides", "2"], "sides is 2: expected at least 3"),
    ],
)
def test_errors_are_one_line(folder, capsys, arguments, message):
    assert main(["suite", *arguments]) == 1
    captured = capsys.readouterr()
    assert message in captured.err and captured.err.count("\n") == 1


def test_a_missing_solver_is_named(monkeypatch, capsys):
    absent = ConicSolver("absent", "absent-package", "no_such_module", "MIT", {"default": 1e-8}, lambda *_: None)
    monkeypatch.setitem(SOLVERS, "absent", absent)
    assert main(["suite", "run", "--solver", "absent"]) == 1
    assert "no_such_module is not installed: pip install absent-package" in capsys.readouterr().err


@pytest.mark.parametrize("name", [name for name, solver in SOLVERS.items() if solver.licence != "commercial"])
def test_adapters_answer_as_the_reference_does(name):
    """On ordinary and infeasible problems, soft fingers and torque limits, where the solver is installed."""
    solver = SOLVERS[name]
    if not solver.is_installed():
        pytest.skip(f"{name} is not installed")
    kinds = ("ordinary", "soft_fingers", "torque_limits", "zero_friction", "idle_contacts", "infeasible")
    problems = [p for p in FEW if p.kind in kinds]
    for is_scaled in (True, False):
        answers = solver.solve_all(problems, is_scaled=is_scaled)
        scores = [S.score(p, a, judged_tolerance(solver.tolerances["default"])) for p, a in zip(problems, answers)]
        wrong = [s.problem for s in scores if s.outcome in (S.Outcome.WRONG, S.Outcome.INFEASIBLE_SOLVED)]
        assert not wrong and sum(s.outcome is S.Outcome.RIGHT for s in scores) >= (4 if is_scaled else 2)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["jaxgrasp", "jaxgrasp-kernel"])
def test_our_answers_are_never_wrong_in_silence(name):
    from jaxgrasp.cli.suite_solver import OwnSolver

    own = OwnSolver(name)
    scores = [S.score(p, a, judged_tolerance(own.tolerance)) for p, a in zip(PROBLEMS, own.solve_all(PROBLEMS))]
    wrong = [s.problem for s in scores if s.outcome in (S.Outcome.WRONG, S.Outcome.INFEASIBLE_SOLVED)]
    assert not wrong
