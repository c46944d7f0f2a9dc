"""Every rival solves ordinary problems; the judge alone says so, in extended precision."""

import ast
import json
import re
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.page import decisions, gradients, tables
from benchmarks.page.errors import best, measure
from benchmarks.rivals import registry
from benchmarks.rivals.interface import Prepared, Rival
from jaxgrasp.testing import problems as P
from jaxgrasp.testing import references as R

COUNT = 8
ROOT = Path(__file__).parent.parent.parent
IN_THE_TEST_EXTRA = ("by_closed_form", "by_jaxgrasp", "by_optimistix", "by_jaxopt", "by_clarabel")


@pytest.fixture(scope="module")
def problem():
    return P.problems("ordinary", 3, COUNT, seed=1)


@pytest.fixture(scope="module")
def best_answers(problem):
    """Return the best pairs of forces and multiplier that an interior-point method finds at several tolerances."""
    best_pair = best(
        problem, problem.squeeze, [rival.solve(problem, problem.squeeze) for rival in rivals("by_clarabel")]
    )
    assert best_pair.score.max() < 1e-9
    return best_pair


def rivals(module: str) -> list[Rival]:
    if module not in IN_THE_TEST_EXTRA:
        pytest.importorskip(registry.MODULES[module])
    rivals_found = registry.load(module, registry.MODULES[module], "RIVALS")
    assert not isinstance(rivals_found, str), rivals_found
    return rivals_found


def _first(module: str) -> Rival:
    return rivals(module)[0]


def solves(rival: Rival, problem: P.Problems, best_answers) -> None:
    """Check a rival's claims to its own tolerance; pyramids lie within the cones, so they may cost more."""
    answers = rival.solve(problem, problem.squeeze)
    assert answers.forces.shape == problem.points.shape
    assert not answers.infeasible.any()
    # Interior-point methods stop short of 1e-12 now and then, and say so; plain Newton and its like of one problem in
    # fifteen to a hundred, and which one hangs on rounding.
    safe = 1 if rival.package != "optimistix" else 0.75
    assert answers.solved.mean() >= (safe if rival.tolerance > 1e-10 else 0.5)
    measured = measure(problem, problem.squeeze, answers, best_answers)
    limit = 100 * rival.tolerance
    assert measured.backward_error[answers.solved].max() < limit
    assert measured.violation[answers.solved].max() < limit
    if rival.cones == "circular":
        assert measured.gap[answers.solved].max() < limit
        assert measured.excess[answers.solved].max() < limit


@pytest.mark.parametrize("module", ["by_clarabel", "by_qoco", "by_ecos", "by_scs", "by_moreau", "by_qpax"])
def test_conic_and_quadratic_solvers(module, problem, best_answers):
    for rival in rivals(module):
        solves(rival, problem, best_answers)


@pytest.mark.parametrize("module, name", [("by_optimistix", "Newton"), ("by_jaxopt", "BoxOSQP pyramid of 8 1e-06")])
def test_solvers_behind_our_own_functions(module, name, problem, best_answers):
    (rival,) = [rival for rival in rivals(module) if name in rival.name]
    solves(rival, problem, best_answers)


@pytest.mark.slow
@pytest.mark.parametrize("module", ["by_jaxgrasp", "by_optimistix", "by_jaxopt"])
def test_all_solvers_behind_our_own_functions(module, problem, best_answers):
    for rival in rivals(module):
        solves(rival, problem, best_answers)


def test_contacts_of_weight_zero_keep_their_squeezing_forces(problem):
    weights = np.ones_like(problem.squeeze)
    weights[:, 0] = 0
    held = problem.squeeze[..., None] * problem.normals
    problem = problem._replace(wrench=P.exact_wrench(problem.points, held))
    for rival in rivals("by_clarabel"):
        answers = rival.solve(problem, weights)
        assert answers.solved.all()
        np.testing.assert_allclose(answers.forces[:, 0], held[:, 0], rtol=1e-14)
        judgement = R.judge(problem, weights, answers.forces, answers.multiplier)
        assert judgement.gap.max() < 1e-6 and judgement.backward_error.max() < 1e-6


def test_the_best_pair_is_the_one_that_proves_itself(problem):
    clarabel = _first("by_clarabel").solve(problem, problem.squeeze)
    spoilt = clarabel._replace(forces=1.01 * clarabel.forces)
    best_pair = best(problem, problem.squeeze, [spoilt, clarabel])
    assert (best_pair.source == 1).all()
    np.testing.assert_array_equal(best_pair.forces, clarabel.forces)
    assert 0.005 < measure(problem, problem.squeeze, spoilt, best_pair).force.max() < 0.02


def test_decisions_tell_right_from_wrong():
    honest = _first("by_clarabel")

    def boast(problem, weights):
        prepared = honest.prepare(problem, weights)
        everything = np.ones(len(weights), bool)
        return Prepared(
            prepared.run, lambda raw: prepared.read(raw)._replace(solved=everything, infeasible=~everything)
        )

    rows = decisions.decisions(
        [honest, replace(honest, name="boaster", prepare=boast)],
        decisions.Plan(contacts=3, number=4, kinds=("ordinary", "infeasible")),
    )
    decided = {(row["kind"], row["method"]): (row["right"], row["wrong"], row["failed"]) for row in rows}
    assert decided["ordinary", honest.name] == decided["infeasible", honest.name] == (4, 0, 0)
    assert decided["ordinary", "boaster"] == (4, 0, 0)
    assert decided["infeasible", "boaster"] == (0, 4, 0)


def test_a_missing_package_costs_one_line(monkeypatch):
    monkeypatch.setitem(sys.modules, "qoco", None)
    monkeypatch.delitem(sys.modules, "benchmarks.rivals.by_qoco", raising=False)
    line = registry.load("by_qoco", "qoco", "RIVALS")
    assert isinstance(line, str) and "pip install 'jaxgrasp[bench]'" in line and "\n" not in line
    with pytest.raises(ModuleNotFoundError):
        registry.load("by_qoco", "something else", "RIVALS")


@pytest.mark.parametrize("module", gradients.MODULES)
def test_layers_find_the_same_derivatives(module):
    for library in gradients.MODULES[module]:
        pytest.importorskip(library)
    problem = P.problems("ordinary", 3, 4, seed=1)
    expected = gradients.central_differences(problem)
    (tight,) = [
        differentiator
        for differentiator in registry.load(module, gradients.MODULES[module], "DIFFERENTIATORS")
        if "1e-10" in differentiator.name
    ]
    assert gradients.relative_distance(tight.prepare(problem)(), expected).max() < 1e-3


@pytest.mark.parametrize("module, needs", gradients.MODULES.items())
def test_a_differentiator_without_its_libraries_is_one_line(monkeypatch, module, needs):
    """Whichever of its libraries is missing, those that another of them brings too."""
    monkeypatch.delitem(sys.modules, f"benchmarks.rivals.{module}", raising=False)
    for library in needs:
        monkeypatch.setitem(sys.modules, library, None)
    line = registry.load(module, needs, "DIFFERENTIATORS")
    assert re.fullmatch(r"\w+ is not installed, so its rows are left out: pip install 'jaxgrasp\[bench\]'", line)
    assert line.split()[0] in needs


@pytest.mark.parametrize("module, needs", [*registry.MODULES.items(), *gradients.MODULES.items()])
def test_every_library_that_a_rival_imports_is_known(module, needs):
    """From the files' text: an import beside those that the package itself needs would end in a traceback."""
    tree = ast.parse((Path(registry.__file__).parent / f"{module}.py").read_text())
    imported = {alias.name for node in ast.walk(tree) if isinstance(node, ast.Import) for alias in node.names}
    imported |= {node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom) and node.module}
    always = {"benchmarks", "jaxgrasp", "jax", "jaxtyping", "numpy", "scipy", "equinox", "optimistix", "lineax"}
    others = {name.partition(".")[0] for name in imported} - always - sys.stdlib_module_names
    assert others <= ({needs} if isinstance(needs, str) else set(needs))


@pytest.mark.parametrize("sections", [("singles",), ("batches",), ("singles", "batches")])
def test_a_page_of_some_sections_has_their_table(sections):
    """The page of some sections is the committed one without the tables of the others."""
    report = json.loads((ROOT / "benchmarks" / "results" / "constrained_optimum.json").read_text())
    some_sections = {
        name: part for name, part in report.items() if name in (*sections, "machine", "missing", "extended_precision")
    }
    page = tables.page(some_sections)
    assert "## Time and error on ordinary problems" in page
    rows = [line for line in page.splitlines() if line.startswith("| jaxgrasp")]
    names = {row["method"] for name in sections for row in report[name]}
    assert len(rows) >= sum(name.startswith("jaxgrasp") for name in names) > 0
