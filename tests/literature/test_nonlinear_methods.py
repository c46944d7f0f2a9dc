"""The methods that are no linear programs: what each of them minimises, against an independent route."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrasp import Grasp, closed_form, constrained_optimum, pyramid_optimum
from jaxgrasp.literature import MethodStatus, buss, kuhn_tucker, kumar_waldron, nakamura
from jaxgrasp.literature.kumar_waldron import equilibrating_forces
from jaxgrasp.literature.method_input import read_input
from jaxgrasp.literature.scaled_problems import ScaledBatch, scale
from jaxgrasp.testing import problems as P
from jaxgrasp.testing import references as R

COUNT, N = 40, 4


def grasp_of(problem: P.Problems, **changes) -> Grasp:
    fields = {name: getattr(problem, name) for name in ("points", "normals", "friction", "squeeze")}
    return Grasp(**(fields | changes))


@pytest.fixture(scope="module")
def problem() -> P.Problems:
    return P.problems("ordinary", N, COUNT, seed=21)


@pytest.fixture(scope="module")
def loose(problem) -> Grasp:
    """Return the same contacts without squeezing forces."""
    return grasp_of(problem, squeeze=np.zeros((COUNT, N)))


def in_cones(problem: P.Problems, forces: np.ndarray, tolerance: float) -> np.ndarray:
    along = np.sum(forces * problem.normals, -1)
    across = np.linalg.norm(forces - along[..., None] * problem.normals, axis=-1)
    return (across <= problem.friction * along + tolerance).all(-1)


@pytest.mark.slow
def test_nakamura_is_the_least_norm_in_the_cones(problem, loose):
    """The least norm in the cones is the constrained optimum without squeezing forces, shared uniformly."""
    answer, optimum = nakamura(grasp_of(problem), problem.wrench), constrained_optimum(loose, problem.wrench, "uniform")
    assert (answer.status == MethodStatus.SOLVED).all()
    half_square = np.sum(answer.forces**2, (1, 2)) / 2
    np.testing.assert_allclose(half_square, optimum.objective, rtol=1e-8)
    largest = np.abs(answer.forces).max()
    np.testing.assert_allclose(answer.forces, optimum.forces, atol=1e-7 * largest)
    balancing = closed_form(loose, problem.wrench, "uniform").forces
    internal = np.sqrt(np.sum((answer.forces - balancing) ** 2, (1, 2)))
    np.testing.assert_allclose(answer.objective, internal, rtol=1e-6, atol=1e-8)
    assert (in_cones(problem, balancing, 0) == (answer.iterations == 0)).all()


def test_nakamura_proves_what_cannot_be_held():
    problem = P.problems("infeasible", N, COUNT, seed=3)
    assert (nakamura(grasp_of(problem), problem.wrench).status == MethodStatus.INFEASIBLE).all()


@pytest.mark.slow
@pytest.mark.parametrize("sharing", ["squeeze", "uniform"])
def test_kuhn_tucker_is_dearer_than_the_cones_and_closes_in_on_them(problem, sharing):
    optimum = constrained_optimum(grasp_of(problem), problem.wrench, sharing)
    scale_of = np.maximum(optimum.objective, 1e-9 * np.max(optimum.objective))
    prices = []
    for sides in (4, 8, 16):
        answer = kuhn_tucker(grasp_of(problem), problem.wrench, sharing=sharing, sides=sides)
        good = answer.status == MethodStatus.SOLVED
        assert good.mean() > 0.9 and in_cones(problem, answer.forces, 1e-9)[good].all()
        prices.append(np.where(good, (answer.objective - optimum.objective) / scale_of, 0))
        assert (prices[-1] > -1e-8).all()
        weights = problem.weights(sharing)
        apart = np.sum((answer.forces - problem.squeeze[..., None] * problem.normals) ** 2, -1)
        np.testing.assert_allclose(
            answer.objective[good], np.sum(apart / (2 * weights), -1)[good], rtol=1e-9, atol=1e-9
        )
    assert prices[0].mean() > 2 * prices[1].mean() > 4 * prices[2].mean() > 0


def test_kuhn_tucker_agrees_with_another_solver_of_the_same_pyramids(problem):
    answer = kuhn_tucker(grasp_of(problem), problem.wrench, sides=8)
    optimum = pyramid_optimum(grasp_of(problem), problem.wrench, sides=8, tol=1e-8)
    is_solved_by_both = (answer.status == MethodStatus.SOLVED) & (optimum.verdict == 1)
    assert is_solved_by_both.mean() > 0.8
    offset = np.sum(problem.squeeze, -1) / 2
    apart = np.abs(answer.objective - optimum.objective) / np.maximum(answer.objective, offset)
    assert apart[is_solved_by_both].max() < 1e-4 and np.median(apart[is_solved_by_both]) < 1e-7


def test_kuhn_tucker_takes_no_steps_where_the_closed_form_is_allowed(problem):
    closed = closed_form(grasp_of(problem), problem.wrench)
    answer = kuhn_tucker(grasp_of(problem), problem.wrench, sides=32)
    idle = answer.iterations == 0
    assert 0.2 < idle.mean() < 0.8
    np.testing.assert_allclose(answer.forces[idle], closed.forces[idle], atol=1e-9)
    assert not in_cones(problem, closed.forces, -1e-3)[~idle].all()


def test_kuhn_tucker_says_when_its_steps_run_out(problem):
    answer = kuhn_tucker(grasp_of(problem), problem.wrench, max_steps=1)
    assert set(answer.status.tolist()) == {MethodStatus.SOLVED, MethodStatus.NOT_CONVERGED}
    assert (answer.forces[answer.status == MethodStatus.NOT_CONVERGED] == 0).all()


@pytest.mark.parametrize("kind", ["ordinary", "near_collinear", "far_frame"])
def test_equilibrating_forces_are_the_pseudo_inverse_without_interaction(kind):
    problem = P.problems(kind, N, COUNT, seed=8)
    scaled, size = scale(read_input(grasp_of(problem), problem.wrench))
    batch = ScaledBatch(*map(jnp.asarray, scaled))
    forces = np.asarray(equilibrating_forces(batch)) * np.asarray(size)[:, None, None]
    # An extended-precision pseudo-inverse that shares nothing with the package.
    still = problem._replace(squeeze=np.zeros_like(problem.squeeze))
    expected, _ = R.closed_form_reference(still, np.ones((COUNT, N)))
    # How far rounding of the points moves them grows as the contacts near a line.
    assert np.abs(forces - expected).max() < (1e-7 if kind == "near_collinear" else 1e-9) * np.abs(forces).max()
    lines = problem.points[:, :, None] - problem.points[:, None]
    between = np.sum((forces[:, :, None] - forces[:, None]) * lines, -1)
    assert np.abs(between).max() < 1e-10 * np.abs(forces).max() * np.abs(lines).max()


def test_kumar_waldron_adds_the_least_pull_towards_the_centroid(problem, loose):
    """Found by trying strengths one after the other, too."""
    answer = kumar_waldron(grasp_of(problem), problem.wrench)
    balancing = np.asarray(closed_form(loose, problem.wrench, "uniform").forces)
    towards = problem.points.mean(1, keepdims=True) - problem.points
    tried = np.concatenate([[0], np.logspace(0, 7, 4000)])
    for i in range(COUNT):
        lane = problem._replace(normals=problem.normals[i], friction=problem.friction[i])
        along = [in_cones(lane, balancing[i] + x * towards[i], 0) for x in tried]
        works = tried[np.array(along)]
        # An interval may lie between two strengths that are tried.
        assert answer.status[i] == MethodStatus.SOLVED or not len(works)
        moved = answer.forces[i] - balancing[i]
        strength = np.sum(moved * towards[i]) / np.sum(towards[i] ** 2)
        np.testing.assert_allclose(moved, strength * towards[i], atol=1e-7)
        if len(works):
            assert -1e-7 <= strength <= works[0] * (1 + 1e-9) + 1e-7
            assert strength >= tried[max(np.searchsorted(tried, works[0]) - 1, 0)] * (1 - 1e-9)
            assert answer.objective[i] == pytest.approx(strength * np.linalg.norm(towards[i], axis=-1).max(), abs=1e-6)


@pytest.mark.slow
def test_kumar_waldron_fails_where_a_normal_looks_past_the_centroid(problem):
    """Though allowed forces exist for all of these: and then it says so."""
    answer = kumar_waldron(grasp_of(problem), problem.wrench)
    failed = answer.status == MethodStatus.OUTSIDE_CONES
    assert failed.any() and not in_cones(problem, answer.forces, 0)[failed].any()
    optimum = constrained_optimum(grasp_of(problem), problem.wrench)
    assert (optimum.verdict[failed] <= 1).all()


def test_kumar_waldron_with_safety_keeps_a_margin(problem):
    answer = kumar_waldron(grasp_of(problem), problem.wrench, safety=1.25)
    good = answer.status == MethodStatus.SOLVED
    assert good.any()
    tighter = problem._replace(friction=problem.friction / 1.25)
    assert in_cones(tighter, answer.forces, 1e-6)[good].all()


def definite(forces: np.ndarray, problem: P.Problems) -> np.ndarray:
    """Return the eigenvalues ``(B, n, 3)`` of every contact's matrix P."""
    along = problem.friction * np.sum(forces * problem.normals, -1)
    across = np.linalg.norm(np.cross(problem.normals, forces), axis=-1)
    return np.stack([along - across, along, along + across], -1)


def trade(forces: np.ndarray, problem: P.Problems, effort: float, margin: float) -> np.ndarray:
    eigenvalues = definite(forces, problem)
    assert (eigenvalues > 0).all()
    return np.sum(effort * eigenvalues + margin / eigenvalues, (1, 2))


@pytest.mark.parametrize("effort, margin", [(1.0, 1.0), (1.0, 30.0), (5.0, 0.1)])
def test_buss_cannot_be_bettered_by_internal_forces(problem, effort, margin):
    """The trade is convex, so a slope of zero along every internal force proves the optimum."""
    answer = buss(grasp_of(problem), problem.wrench, effort=effort, margin=margin)
    assert (answer.status == MethodStatus.SOLVED).all()
    objective = trade(answer.forces, problem, effort, margin)
    np.testing.assert_allclose(answer.objective, objective, rtol=1e-8)
    rng = np.random.default_rng(0)
    room = definite(answer.forces, problem).min((1, 2))
    for _ in range(20):
        loose = grasp_of(problem, squeeze=np.zeros((COUNT, N)))
        internal = rng.normal(size=(COUNT, N, 3))
        internal = internal - np.asarray(closed_form(loose, exact(problem, internal), "uniform").forces)
        step = 1e-3 * (room / np.abs(internal).max((1, 2)))[:, None, None] * internal
        ends = [trade(answer.forces + sign * step, problem, effort, margin) for sign in (-1, 1)]
        slope, bend = (ends[1] - ends[0]) / 2, ends[0] + ends[1] - 2 * objective
        # How far the minimum along this line is from where it should be, in steps.
        assert (np.abs(slope) <= 1e-2 * bend + 1e-11 * objective).all()


def exact(problem: P.Problems, forces: np.ndarray) -> np.ndarray:
    return P.exact_wrench(problem.points, forces)


def test_buss_trades_effort_for_margin(problem):
    answers = [buss(grasp_of(problem), problem.wrench, margin=margin) for margin in (0.1, 1.0, 10.0)]
    least = np.array([definite(answer.forces, problem).min((1, 2)) for answer in answers])
    effort = np.array([definite(answer.forces, problem).sum((1, 2)) for answer in answers])
    assert (np.diff(effort, axis=0) > 0).all() and (np.diff(least, axis=0).mean(-1) > 0).all()


def test_buss_scales_where_the_margin_does(problem):
    answer = buss(grasp_of(problem), problem.wrench)
    larger = buss(grasp_of(problem, squeeze=100 * problem.squeeze), 100 * problem.wrench, margin=1e4)
    np.testing.assert_allclose(larger.forces, 100 * answer.forces, rtol=1e-6, atol=1e-3)


@pytest.mark.slow
def test_both_flows_of_buss_end_at_one_place(problem):
    dikin = buss(grasp_of(problem), problem.wrench, margin=30.0)
    plain = buss(grasp_of(problem), problem.wrench, margin=30.0, flow="gradient", max_steps=20_000)
    is_solved = plain.status == MethodStatus.SOLVED
    assert is_solved.mean() > 0.5
    np.testing.assert_allclose(plain.objective[is_solved], dikin.objective[is_solved], rtol=1e-6)
    assert plain.iterations[is_solved].mean() > 3 * dikin.iterations[is_solved].mean()


def test_buss_needs_room_inside_the_cones():
    slippery = P.problems("zero_friction", N, COUNT, seed=3)
    answer = buss(grasp_of(slippery), slippery.wrench)
    assert not (answer.status == MethodStatus.SOLVED).any()
    hopeless = P.problems("infeasible", N, COUNT, seed=3)
    assert (buss(grasp_of(hopeless), hopeless.wrench).status == MethodStatus.INFEASIBLE).all()


@pytest.mark.parametrize(
    "method, options, message",
    [
        (nakamura, {"max_rounds": 0}, "max_rounds is 0"),
        (buss, {"margin": 0.0}, "margin is 0.0"),
        (buss, {"effort": float("inf")}, "effort is inf"),
        (buss, {"flow": "newton"}, "flow is 'newton'"),
        (buss, {"max_steps": 0}, "max_steps is 0"),
        (kumar_waldron, {"safety": 0.5}, "safety is 0.5"),
        (kuhn_tucker, {"sharing": "even"}, "sharing is 'even'"),
        (kuhn_tucker, {"sides": 2}, "sides is 2"),
        (kuhn_tucker, {"max_steps": 0}, "max_steps is 0"),
    ],
)
def test_bad_arguments_raise(problem, method, options, message, unchecked):
    with pytest.raises(ValueError, match=message):
        method(grasp_of(problem), problem.wrench, **options)


@pytest.mark.parametrize("method", [nakamura, kumar_waldron, kuhn_tucker])
def test_forces_scale_with_the_load_and_turn_with_the_frame(problem, method):
    """Circular cones know no axes; pyramids turn where the axes change places."""
    answer = method(grasp_of(problem), problem.wrench)
    larger = method(grasp_of(problem, squeeze=1e3 * problem.squeeze), 1e3 * problem.wrench)
    np.testing.assert_allclose(larger.objective, 1e3 * answer.objective, rtol=1e-6, atol=1e-6)
    turned = grasp_of(problem, points=np.roll(problem.points, 1, -1), normals=np.roll(problem.normals, 1, -1))
    wrench = np.concatenate([np.roll(problem.wrench[:, :3], 1, -1), np.roll(problem.wrench[:, 3:], 1, -1)], -1)
    turned_answer = method(turned, wrench)
    np.testing.assert_allclose(np.roll(turned_answer.forces, -1, -1), answer.forces, atol=1e-6)
    assert jnp.all(turned_answer.status == answer.status)
