"""Laws of the last resort: it decides what float64 leaves open, is never wrong, and is refused where traced."""

import jax
import numpy as np
import pytest

import jaxgrasp
from jaxgrasp import Grasp, Limits, Verdict
from jaxgrasp.problem.batch_last import ProblemBatch
from jaxgrasp.solver import last_resort
from jaxgrasp.testing import suite as S

PROBLEMS = [p for p in S.load_suite() if p.torque_max is None]
OPEN = [p for p in PROBLEMS if p.kind == "once_undecided"]
pytestmark = pytest.mark.skipif(not last_resort.is_available(), reason="long double is no wider than float64 here")


def groups(problems: list[S.SuiteProblem]) -> list[list[S.SuiteProblem]]:
    """Group problems by what their arrays have in common."""
    keys = {(len(p.friction), p.torsion is None) for p in problems}
    return [[p for p in problems if (len(p.friction), p.torsion is None) == key] for key in sorted(keys)]


def stacked(problems: list[S.SuiteProblem], name: str) -> np.ndarray | None:
    arrays = [getattr(problem, name) for problem in problems]
    return None if arrays[0] is None else np.stack(arrays)


def batch(problems: list[S.SuiteProblem]) -> ProblemBatch:
    names = ("points", "normals", "friction", "squeeze", "weights", "wrench", "torsion")
    return ProblemBatch(present=None, **{name: stacked(problems, name) for name in names})


CLAIMS = {
    Verdict.OPTIMAL: S.Claim.SOLVED,
    Verdict.INFEASIBLE: S.Claim.INFEASIBLE,
    Verdict.NOT_CONVERGED: S.Claim.FAILED,
}


def scores(problems: list[S.SuiteProblem]) -> list[S.Score]:
    decided = last_resort.decide(batch(problems), np.arange(len(problems)))
    return [
        S.score(p, S.Answer(CLAIMS[Verdict(v)], decided.forces[i], decided.moments[i], decided.certificate[i]))
        for i, (p, v) in enumerate(zip(problems, decided.verdict))
    ]


def test_it_is_never_wrong_in_silence_and_decides_nearly_all():
    """All problems of the suite but those with torque limits, whoever else can solve them."""
    judged = [score for group in groups(PROBLEMS) for score in scores(group)]
    bad = (S.Outcome.WRONG, S.Outcome.INFEASIBLE_SOLVED, S.Outcome.CLAIMED)
    assert not [score.problem for score in judged if score.outcome in bad]
    assert np.mean([score.outcome is S.Outcome.SAID_SO for score in judged]) < 0.1


def test_it_decides_what_was_open():
    judged = [score for group in groups(OPEN) for score in scores(group)]
    undecided = [score.problem for score in judged if score.outcome is S.Outcome.SAID_SO]
    assert len(undecided) <= 3, undecided


@pytest.mark.slow
def test_a_call_takes_its_answers():
    """The undecided problem of a call is decided, and the answers to others stay as they are to the last bit."""
    few = [p for p in OPEN if len(p.friction) == 3 and "_606" not in p.name][:6] + [
        p for p in PROBLEMS if p.name.startswith("ordinary_3")
    ][:4]
    contacts = [stacked(few, name) for name in ("points", "normals", "friction", "squeeze")]
    wrench, weights = stacked(few, "wrench"), stacked(few, "weights")
    plain = jaxgrasp.constrained_optimum(Grasp(*contacts), wrench, weights)
    resolved = jaxgrasp.constrained_optimum(Grasp(*contacts), wrench, weights, last_resort=True)
    was_open = np.asarray(plain.verdict) == Verdict.NOT_CONVERGED
    assert was_open.any() and not (np.asarray(resolved.verdict) == Verdict.NOT_CONVERGED).any()
    for old, new in zip(jax.tree.leaves(plain), jax.tree.leaves(resolved)):
        np.testing.assert_array_equal(np.asarray(old)[~was_open], np.asarray(new)[~was_open])
    proven = jaxgrasp.verify_certificate(Grasp(*contacts), wrench, resolved.certificate, weights)
    load = np.linalg.norm(wrench[:, :3], axis=-1)
    assert (np.asarray(proven)[was_open] > 1e5 * load[was_open]).all()


def test_it_is_refused_where_it_cannot_be():
    problem = OPEN[0]
    grasp = Grasp(problem.points, problem.normals, problem.friction, problem.squeeze)
    with pytest.raises(ValueError, match="last_resort is given inside jit"):
        jax.jit(lambda w: jaxgrasp.constrained_optimum(grasp, w, last_resort=True))(problem.wrench)
    limits = Limits(normal_max=np.full(len(problem.friction), 10.0))
    with pytest.raises(ValueError, match="limits and last_resort are both given"):
        jaxgrasp.constrained_optimum(grasp, problem.wrench, limits=limits, last_resort=True)
