"""The reachable margin: between bounds proven in extended precision, with derivatives that are its differences."""

import jax
import numpy as np
import pytest

import jaxgrasp
from jaxgrasp import Grasp, Verdict
from jaxgrasp.testing import problems as P
from jaxgrasp.testing.reachable_limits import reachable_limit

COUNT, N = 64, 3
THETA = 1e-8
EVERYONE = np.ones((COUNT, N))
INPUTS = ("points", "normals", "friction", "squeeze", "wrench", "direction")


def margin(problem: P.Problems, direction, weights=None, present: np.ndarray = EVERYONE, progress=None) -> np.ndarray:
    grasp = Grasp(problem.points, problem.normals, problem.friction, problem.squeeze, present)
    weights = problem.squeeze if weights is None else weights
    return np.asarray(jaxgrasp.wrench_margin(grasp, problem.wrench, direction, weights, progress=progress))


def aside(problem: P.Problems, seed: int) -> np.ndarray:
    """Return random directions a tenth of the squeeze long, about the middle of the contacts."""
    middle = problem.points.mean(1)
    radius = np.linalg.norm(problem.points - middle[:, None], axis=-1).mean(-1)[:, None]
    force, torque = np.random.default_rng(seed).normal(size=(2, COUNT, 3)) * problem.squeeze.sum(-1)[:, None] / 10
    return np.concatenate([force, radius * torque + np.cross(middle, force)], -1)


def between_bounds(problem: P.Problems, direction: np.ndarray, weights: np.ndarray, theta: np.ndarray) -> int:
    """Assert that no proven bound is broken, and return how many finite ones were tight enough to say so."""
    pytest.importorskip("clarabel")
    limit = reachable_limit(problem, weights, direction)
    lower, upper = np.asarray(limit.lower, float), np.asarray(limit.upper, float)
    assert (theta[np.isposinf(lower)] == np.inf).all()
    above, below = np.isfinite(lower), np.isfinite(upper)
    slack = THETA * np.abs(theta)
    assert (theta[above] >= (lower - np.where(np.isfinite(theta), slack, 0))[above]).all()
    assert (theta[below] <= (upper + slack)[below]).all()
    is_bounded = above & below
    return int(np.sum(upper[is_bounded] - lower[is_bounded] <= slack[is_bounded]))


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["ordinary", "low_friction", "far_frame", "scales", "wide_squeeze"])
def test_margin_lies_between_proven_bounds(kind):
    problem = P.problems(kind, N, COUNT, seed=1)
    direction = aside(problem, seed=2)
    theta = margin(problem, direction)
    assert np.isfinite(theta).mean() > 0.3
    tight = between_bounds(problem, direction, problem.squeeze, theta)
    assert tight > 0.7 * np.isfinite(theta).sum()


@pytest.mark.slow
@pytest.mark.repeats
@pytest.mark.parametrize("kind", ["ordinary", "low_friction", "coincident_some", "scales", "far_frame"])
@pytest.mark.parametrize("n", [4, 5, 10])
def test_margin_lies_between_proven_bounds_over_more_problems(kind, n):
    for seed in range(3, 9):
        problem = P.problems(kind, n, COUNT, seed)
        direction = aside(problem, seed)
        between_bounds(problem, direction, problem.squeeze, margin(problem, direction, present=np.ones((COUNT, n))))


def verdicts(problem: P.Problems, wrench: np.ndarray) -> np.ndarray:
    grasp = Grasp(problem.points, problem.normals, problem.friction, problem.squeeze, EVERYONE)
    return np.asarray(jaxgrasp.constrained_optimum(grasp, wrench, problem.squeeze).verdict)


@pytest.mark.slow
def test_the_optimum_knows_the_same_limit():
    """A thousandth short of the margin forces exist, and a thousandth beyond it a proof that none do."""
    for kind in ("ordinary", "low_friction"):
        problem = P.problems(kind, N, COUNT, seed=3)
        direction = aside(problem, seed=4)
        theta = margin(problem, direction)
        finite = np.isfinite(theta)
        reach = np.where(finite, theta, 100.0)[:, None] * direction
        assert (verdicts(problem, problem.wrench + 0.999 * reach) <= Verdict.OPTIMAL).all()
        assert (verdicts(problem, problem.wrench + 1.001 * reach)[finite] == Verdict.INFEASIBLE).all()


@pytest.mark.slow
def test_it_starts_and_ends_where_the_wrench_does():
    """Margins along one line share their end; theta is measured in units of the direction."""
    problem = P.problems("ordinary", N, COUNT, seed=5)
    direction = aside(problem, seed=6)
    theta = margin(problem, direction)
    ahead = problem._replace(wrench=problem.wrench + 7 * direction)
    scaled = problem._replace(wrench=problem.wrench * 1e3)
    tolerance = 1e-9 * (1 + np.where(np.isfinite(theta), np.abs(theta), 0))
    for got, expected in (
        (margin(ahead, direction) + 7, theta),
        (margin(problem, 10 * direction) * 10, theta),
        (margin(scaled, direction) / 1e3, theta),
        (margin(problem._replace(squeeze=3 * problem.squeeze), direction), theta),
        (margin(problem, direction, problem.squeeze**2), theta),
    ):
        endless = np.isinf(expected)
        np.testing.assert_array_equal(got[endless], expected[endless])
        assert (np.abs(got[~endless] - expected[~endless]) <= tolerance[~endless]).all()


@pytest.mark.slow
def test_frames_do_not_matter():
    problem = P.problems("ordinary", N, COUNT, seed=7)
    direction = aside(problem, seed=8)
    theta = margin(problem, direction)
    q, _ = np.linalg.qr(np.random.default_rng(9).normal(size=(3, 3)))
    q *= np.linalg.det(q)
    offset = np.array([0.5, -1.0, 2.0])

    def turned(wrench):
        return (wrench.reshape(COUNT, 2, 3) @ q.T).reshape(COUNT, 6)

    def moved(wrench):
        return np.concatenate([wrench[:, :3], wrench[:, 3:] + np.cross(offset, wrench[:, :3])], -1)

    rotated = problem._replace(
        points=problem.points @ q.T, normals=problem.normals @ q.T, wrench=turned(problem.wrench)
    )
    shifted = problem._replace(points=problem.points + offset, wrench=moved(problem.wrench))
    np.testing.assert_allclose(margin(rotated, turned(direction)), theta, rtol=1e-9)
    np.testing.assert_allclose(margin(shifted, moved(direction)), theta, rtol=1e-9)


def case(points, normals, friction, wrench, direction):
    """Return one problem in every lane, with garbage in missing contacts, its direction and its presence mask."""
    missing = ((0, N - len(points)), (0, 0))
    rows = [np.pad(np.asarray(a, float), missing, constant_values=np.nan) for a in (points, normals)]
    rows += [np.full(N, float(friction)), np.full(N, 4.0), np.asarray(wrench, float)]
    present = (np.arange(N) < len(points)).astype(float)
    lanes = [np.broadcast_to(row, (COUNT, *row.shape)).copy() for row in rows]
    direction = np.broadcast_to(np.asarray(direction, float), (COUNT, 6)).copy()
    return P.Problems("known", *lanes, None), direction, np.broadcast_to(present, (COUNT, N)).copy()


PAIR = ([[0.5, 0, 0], [-0.5, 0, 0]], [[-1, 0, 0], [1, 0, 0]], 0.5)
FEET = ([[0.2, 0, 0], [-0.1, 0.15, 0], [-0.1, -0.15, 0]], [[0, 0, 1]] * 3)
KNOWN_MARGINS = {
    # One finger presses with 2 N at friction 0.5.
    "one contact slips": ([[1, 0, 0]], [[0, 0, 1]], 0.5, [0, 0, 2, 0, -2, 0], [0, 1, 0, 0, 0, 1], 1.0),
    "one contact unloads": ([[1, 0, 0]], [[0, 0, 1]], 0.5, [0, 0, 2, 0, -2, 0], [0, 0, -1, 0, 1, 0], 2.0),
    "one contact cannot pull": ([[1, 0, 0]], [[0, 0, 1]], 0.5, [0, 0, -2, 0, 2, 0], [0, 0, -1, 0, 1, 0], -2.0),
    # Two antipodal fingers squeeze as hard as they need, but resist no torque about their line.
    "a pair lifts anything": (*PAIR, [0, 0, 1, 0, 0, 0], [0, 0, 1, 0, 0, 0], np.inf),
    "a pair turns about its line": (*PAIR, [0, 0, 1, 0, 0, 0], [0, 0, 0, 1, 0, 0], 0.0),
    "a pair is turned already": (*PAIR, [0, 0, 1, 0.1, 0, 0], [0, 0, 0, 1, 0, 0], -0.1),
    "no help against a turn": (*PAIR, [0, 0, 1, 0.1, 0, 0], [0, 0, 1, 0, 0, 0], -np.inf),
    # 10 N stand on three feet in the plane, pushed along x at the height h: slides at 10 mu, tips over a foot 0.2 m
    # ahead or an edge 0.1 m behind at 10 N times that over h.
    "feet slide": (*FEET, 0.4, [0, 0, 10, 0, 0, 0], [1, 0, 0, 0, 0.1, 0], 4.0),
    "feet tip forwards": (*FEET, 0.9, [0, 0, 10, 0, 0, 0], [-1, 0, 0, 0, -0.5, 0], 4.0),
    "feet tip backwards": (*FEET, 0.9, [0, 0, 10, 0, 0, 0], [1, 0, 0, 0, 0.5, 0], 2.0),
    "feet press for ever": (*FEET, 0.4, [0, 0, 10, 0, 0, 0], [0, 0, 1, 0, 0, 0], np.inf),
    "nothing is asked for": (*FEET, 0.4, [0, 0, 10, 0, 0, 0], [0] * 6, np.inf),
    "nothing to lift": (*FEET, 0.4, [0] * 6, [1, 0, 0, 0, 0, 0], 0.0),
    "nobody there": ([], [], 0.4, [0] * 6, [1, 0, 0, 0, 0, 0], 0.0),
    "nobody to hold": ([], [], 0.4, [0, 0, 1, 0, 0, 0], [1, 0, 0, 0, 0, 0], -np.inf),
}


@pytest.mark.parametrize("name", KNOWN_MARGINS)
def test_known_margins(name):
    *arguments, expected = KNOWN_MARGINS[name]
    arguments[:2] = (np.reshape(a, (-1, 3)) for a in arguments[:2])
    problem, direction, present = case(*arguments)
    np.testing.assert_allclose(margin(problem, direction, present=present), expected, rtol=1e-9, atol=1e-9)


def test_contacts_of_weight_zero_hold_their_squeezing_force():
    """Their wrench comes off the one asked for, and they resist nothing more."""
    problem = P.problems("ordinary", N, COUNT, seed=10)
    direction = aside(problem, seed=11)
    weights = np.ones((COUNT, N))
    weights[:, 0] = 0
    held = np.where(weights > 0, 0, problem.squeeze)[..., None] * problem.normals
    pressed = problem._replace(wrench=problem.wrench + P.exact_wrench(problem.points, held))
    without = margin(problem, direction, present=weights)
    np.testing.assert_allclose(margin(pressed, direction, weights), without, rtol=1e-8, atol=1e-9)
    finger, push, _ = case([[1, 0, 0], [2, 0, 0]], [[0, 0, 1], [0, 0, 1]], 0.5, [0, 1, 4, 0, -8, 2], [0, 1, 0, 0, 0, 1])
    # The far finger only presses, with 4 N, and leaves the wrench (0, 1, 0; 0, 0, 2) to one that cannot give it.
    alone = np.broadcast_to([1.0, 0.0, 0.0], (COUNT, N))
    assert (margin(finger, push, alone, np.broadcast_to([1.0, 1.0, 0.0], (COUNT, N))) == -np.inf).all()
    finger.wrench[:] = [0, 0, 6, 0, -10, 0]
    theta = margin(finger, push, alone, np.broadcast_to([1.0, 1.0, 0.0], (COUNT, N)))
    np.testing.assert_allclose(theta, 1.0, rtol=1e-9)


def test_bad_data_leave_their_neighbours_alone():
    problem = P.problems("ordinary", N, COUNT, seed=12)
    direction = aside(problem, seed=13)
    progress: list[int] = []
    theta = margin(problem, direction, progress=progress.append)
    assert progress == [COUNT]
    arrays = {name: getattr(problem, name).copy() for name in ("points", "friction", "wrench")}
    arrays["points"][3, 1, 0], arrays["friction"][20, 2], arrays["wrench"][40, 4] = np.nan, -0.5, np.inf
    direction[50, 0] = np.nan
    bad = np.isin(np.arange(COUNT), [3, 20, 40, 50])
    other_theta = margin(problem._replace(**arrays), direction)
    assert (other_theta[bad] == -np.inf).all()
    np.testing.assert_allclose(other_theta[~bad], theta[~bad], rtol=1e-9)


@jax.jit
def moved_margin(inputs, weights, present, tangents):
    """Compute the margin, its forward and its reverse derivative; compiled once for all tests."""

    def theta(points, normals, friction, squeeze, wrench, direction):
        return jaxgrasp.wrench_margin(Grasp(points, normals, friction, squeeze, present), wrench, direction, weights)

    value, forward = jax.linearize(theta, *inputs)
    return value, forward(*tangents), jax.linear_transpose(forward, *inputs)(jax.numpy.ones_like(value))


def inputs_of(problem: P.Problems, direction: np.ndarray):
    return tuple(getattr(problem, name) for name in INPUTS[:5]) + (direction,)


def steps(inputs, seed: int):
    rng = np.random.default_rng(seed)
    sizes = (0.02, 1.0, 1.0, 1.0, 5.0, 1.0)
    return tuple(size * rng.normal(size=x.shape) for size, x in zip(sizes, inputs, strict=True))


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["ordinary", "low_friction"])
def test_derivatives_are_limits_of_differences(kind):
    """Fourth-order central differences at four step lengths, of which the best counts: kinks lie close by."""
    problem = P.problems(kind, N, COUNT, seed=14)
    inputs = inputs_of(problem, aside(problem, seed=15))
    moved = steps(inputs, seed=16)
    for name in INPUTS:
        tangent_in = tuple(m if field == name else 0 * m for field, m in zip(INPUTS, moved, strict=True))
        value, tangent, pulled = (
            jax.device_get(x) for x in moved_margin(inputs, problem.squeeze, EVERYONE, tangent_in)
        )
        finite = np.isfinite(value)
        best = np.full(COUNT, np.inf)
        for h in (1e-3, 1e-4, 1e-5, 1e-6):
            far = [
                margin(problem._replace(**dict(zip(INPUTS[:5], x[:5], strict=True))), x[5], problem.squeeze)
                for q in (-2, -1, 1, 2)
                for x in [tuple(a + q * h * b for a, b in zip(inputs, tangent_in, strict=True))]
            ]
            a, b, c, d = (np.where(finite, theta, 0) for theta in far)
            with np.errstate(invalid="ignore"):  # the longest step may lead to where no margin is finite
                difference = (a - 8 * b + 8 * c - d) / (12 * h)
                best = np.fmin(best, np.abs(difference - tangent) / (np.abs(tangent) + np.abs(value)))
        # At the price where the search ends, some 1e9, rounding leaves as many digits of the multipliers.
        assert np.median(best[finite]) < 2e-7 and np.quantile(best[finite], 0.9) < 1e-6, name
        assert (tangent[~finite] == 0).all()
        assert (np.abs(tangent[finite]) > 0).all() == (name != "squeeze")
        reverse = sum(np.sum((p * m).reshape(COUNT, -1), -1) for p, m in zip(pulled, tangent_in, strict=True))
        np.testing.assert_allclose(reverse, tangent, rtol=1e-9, atol=1e-9 * np.abs(tangent).max())


@pytest.mark.slow
def test_derivatives_where_a_contact_holds():
    """A fixed contact's squeeze shifts the wrench: by the normal of what bounds the rest."""
    problem = P.problems("ordinary", N, COUNT, seed=17)
    weights = np.ones((COUNT, N))
    weights[:, 0] = 0
    held = np.where(weights > 0, 0, problem.squeeze)[..., None] * problem.normals
    # Along the wrench of the others' own forces the line stays within what two contacts can do.
    others = P.exact_wrench(problem.points, np.where(weights > 0, problem.squeeze, 0)[..., None] * problem.normals)
    problem = problem._replace(wrench=P.exact_wrench(problem.points, held) + others)
    inputs = inputs_of(problem, -others)

    value, _, gradient = (jax.device_get(x) for x in moved_margin(inputs, weights, EVERYONE, inputs))
    # Unless the two pinch each other, nothing but zero is left where the line ends.
    ends = np.isfinite(value)
    assert ends.mean() > 0.8
    np.testing.assert_allclose(value[ends], 1.0, rtol=1e-7)
    by_squeeze, by_wrench = gradient[3], gradient[4]
    arm = np.concatenate([problem.normals[:, 0], np.cross(problem.points[:, 0], problem.normals[:, 0])], -1)
    np.testing.assert_allclose(by_squeeze[:, 0], -np.sum(by_wrench * arm, -1), rtol=1e-9, atol=1e-9)
    assert (by_squeeze[:, 1:] == 0).all()
    # By the wrench, along the ray: one more of it is one less to go.
    np.testing.assert_allclose(np.sum(by_wrench * -others, -1)[ends], -1.0, rtol=1e-9)


@pytest.mark.slow
def test_absent_contacts_and_endless_margins_have_zero_derivatives_and_none_that_are_none():
    problem, direction, present = case(*KNOWN_MARGINS["feet slide"][:5])
    problem.points[32:], problem.normals[32:], present[32:] = np.nan, np.nan, 0
    problem.points[48:, :2], problem.normals[48:, :2], present[48:, :2] = PAIR[0], PAIR[1], 1
    direction[48:] = [0, 0, 1, 0, 0, 0]
    inputs = inputs_of(problem, direction)
    value, tangent, pulled = (
        jax.device_get(x) for x in moved_margin(inputs, EVERYONE, present, steps(inputs, seed=19))
    )
    np.testing.assert_allclose(value[:32], 4.0, rtol=1e-9)
    assert (value[32:48] == -np.inf).all() and (value[48:] == np.inf).all()
    lost = (value == -np.inf).nonzero()[0]
    assert np.isnan(tangent[lost]).all() and all(np.isnan(part[lost]).all() for part in pulled)
    assert all(np.isfinite(np.delete(part, lost, 0)).all() for part in (tangent, *pulled))
    assert (tangent[48:] == 0).all() and all((part[48:] == 0).all() for part in pulled)
    # Feet slide at mu times the weight: by friction, a foot's share of the weight.
    np.testing.assert_allclose(pulled[2][:32].sum(-1), 10.0, rtol=1e-6)
    np.testing.assert_allclose(pulled[4][:32, 2], 0.4, rtol=1e-6)
    problem, direction, present = case(*KNOWN_MARGINS["one contact slips"][:5])
    inputs = inputs_of(problem, direction)
    _, _, pulled = (jax.device_get(x) for x in moved_margin(inputs, EVERYONE, present, steps(inputs, seed=20)))
    assert all((part[:, 1:] == 0).all() for part in pulled[:4])
    np.testing.assert_allclose(pulled[2][:, 0], 2.0, rtol=1e-6)


def test_second_derivatives_are_refused():
    problem = P.problems("ordinary", N, COUNT, seed=21)
    grasp = Grasp(problem.points, problem.normals, problem.friction, problem.squeeze, EVERYONE)

    def total(wrench):
        return jaxgrasp.wrench_margin(grasp, wrench, aside(problem, seed=22), problem.squeeze).sum()

    with pytest.raises(NotImplementedError, match="first derivatives only"):
        jax.jvp(jax.grad(total), (problem.wrench,), (problem.wrench,))


def test_wrong_arguments_are_named(unchecked):
    problem = P.problems("ordinary", N, COUNT, seed=21)
    with pytest.raises(ValueError, match="expected"):
        margin(problem, np.ones((COUNT, 5)))
    with pytest.raises(ValueError, match="sharing"):
        margin(problem, np.ones(6), "fair")


@pytest.mark.slow
@pytest.mark.optimized
def test_batches_names_and_transformations():
    problem = P.problems("ordinary", N, COUNT, seed=23)
    direction = aside(problem, seed=24)
    grasp = Grasp(problem.points, problem.normals, problem.friction, problem.squeeze)
    theta = margin(problem, direction)
    mapped = jax.jit(jax.vmap(jaxgrasp.wrench_margin))(grasp, problem.wrench, direction)
    named = [jaxgrasp.wrench_margin(grasp, problem.wrench, direction, name) for name in ("squeeze", "uniform")]
    for other_theta in (mapped, *named):
        np.testing.assert_allclose(other_theta, theta, rtol=1e-9)

    def single(grasp, wrench, direction):
        return jax.grad(jaxgrasp.wrench_margin, 1)(grasp, wrench, direction)

    inputs = inputs_of(problem, direction)
    by_wrench = jax.jit(jax.vmap(single))(grasp, problem.wrench, direction)
    _, _, pulled = moved_margin(inputs, problem.squeeze, EVERYONE, steps(inputs, seed=25))
    np.testing.assert_allclose(by_wrench, pulled[4], rtol=1e-6, atol=1e-6 * np.abs(by_wrench).max())
    single_grasp = jax.tree.map(lambda x: x[0], grasp)
    shared = jaxgrasp.wrench_margin(single_grasp, problem.wrench[:8, None], direction[None, :8])
    assert shared.shape == (8, 8)
    size = np.abs(theta[np.isfinite(theta)]).max()
    for i in (0, 7):
        alone = jaxgrasp.wrench_margin(single_grasp, problem.wrench[i], direction[3])
        # A small margin is a difference of numbers of the load's size: programs of other shapes round those.
        np.testing.assert_allclose(shared[i, 3], alone, rtol=1e-9, atol=1e-9 * size)
    assert jaxgrasp.wrench_margin(single_grasp, np.zeros((0, 6)), direction[0]).shape == (0,)
