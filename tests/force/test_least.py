"""With how little a grasp holds its load: against a cone programme, by hand, and the laws of both questions."""

import clarabel
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.sparse
from scipy.spatial.transform import Rotation

from jaxgrasp import Grasp, Verdict, closed_form, grasp_matrix, least_friction, least_squeeze, least_squeeze_factor
from jaxgrasp.sensitivity import friction_reserve
from jaxgrasp.testing import problems as P

COUNT = 24
PINCH = Grasp(
    points=jnp.array([[1.0, 0, 0], [-1, 0, 0]]),
    normals=jnp.array([[-1.0, 0, 0], [1, 0, 0]]),
    friction=jnp.array([0.5, 0.5]),
    squeeze=jnp.array([4.0, 4.0]),
)
LIFT = jnp.array([0.0, 0, 2, 0, 0, 0])


def grasp_of(problem: P.Problems) -> Grasp:
    return Grasp(problem.points, problem.normals, problem.friction, problem.squeeze)


def by_cone_programme(problem: P.Problems, i: int) -> float:
    """Return the least total normal force by Clarabel, infinite where it proves that there is none."""
    normals, friction = problem.normals[i], problem.friction[i]
    n = len(friction)
    rows, right = [np.asarray(grasp_matrix(problem.points[i]))], [problem.wrench[i]]
    for k in range(n):
        cone = np.zeros((4, 3 * n))
        cone[0, 3 * k : 3 * k + 3] = -friction[k] * normals[k]
        cone[1:, 3 * k : 3 * k + 3] = np.outer(normals[k], normals[k]) - np.eye(3)
        rows.append(cone)
        right.append(np.zeros(4))
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = 1e-11
    cones = [clarabel.ZeroConeT(6)] + [clarabel.SecondOrderConeT(4)] * n
    nothing, matrix = scipy.sparse.csc_matrix((3 * n, 3 * n)), scipy.sparse.csc_matrix(np.vstack(rows))
    solver = clarabel.DefaultSolver(nothing, normals.ravel(), matrix, np.concatenate(right), cones, settings)
    solution = solver.solve()
    return np.inf if "Infeasible" in str(solution.status) else solution.obj_val


@pytest.mark.parametrize(
    "kind, n",
    [
        ("ordinary", 3),
        ("infeasible", 3),
        pytest.param("low_friction", 5, marks=pytest.mark.slow),
        pytest.param("ordinary", 10, marks=pytest.mark.slow),
    ],
)
def test_the_least_squeeze_is_that_of_a_cone_programme(kind, n):
    problem = P.problems(kind, n, COUNT, seed=4)
    shares = np.asarray(least_squeeze(grasp_of(problem), problem.wrench, "uniform"))
    expected = np.array([by_cone_programme(problem, i) for i in range(COUNT)])
    np.testing.assert_array_equal(np.isfinite(shares), np.isfinite(expected))
    np.testing.assert_allclose(shares, expected, rtol=1e-7)


@pytest.mark.slow
def test_a_pinch_by_hand():
    np.testing.assert_allclose(least_squeeze(PINCH, LIFT), 2 / 0.5, rtol=1e-9)
    np.testing.assert_allclose(least_friction(PINCH, LIFT), 2 / 8 / 0.5, rtol=1e-8)
    np.testing.assert_allclose(least_friction(PINCH, LIFT, total=16.0), 2 / 16 / 0.5, rtol=1e-8)
    by_friction = jax.grad(lambda mu: least_squeeze(Grasp(PINCH.points, PINCH.normals, mu, PINCH.squeeze), LIFT))
    np.testing.assert_allclose(by_friction(PINCH.friction), [-4, -4], rtol=1e-6)
    by_squeeze = jax.grad(lambda s: least_friction(Grasp(PINCH.points, PINCH.normals, PINCH.friction, s), LIFT))
    np.testing.assert_allclose(by_squeeze(PINCH.squeeze), [-1 / 16, -1 / 16], rtol=1e-6)
    np.testing.assert_allclose(jax.grad(lambda t: least_friction(PINCH, LIFT, total=t))(8.0), -1 / 16, rtol=1e-6)


@pytest.mark.slow
def test_a_share_that_is_not_the_least_has_no_derivative():
    """Halving ends early where friction becomes too small to decide; what is differentiable moves as differences do."""
    problem = P.problems("low_friction", 5, 200, seed=3)
    rows = [jnp.asarray(x) for x in (problem.points, problem.normals, problem.friction, problem.squeeze)]
    wrench = jnp.asarray(problem.wrench)
    share = jax.jit(lambda friction, squeeze: least_friction(Grasp(rows[0], rows[1], friction, squeeze), wrench))
    rng = np.random.default_rng(6)
    moved = [rng.normal(size=x.shape) * np.asarray(x) for x in rows[2:]]
    value, slope = jax.jit(lambda at, by: jax.jvp(share, tuple(at), tuple(by)))(rows[2:], moved)
    apart = []
    for step in (1e-4, 1e-5, 1e-6):
        ends = [share(*(x + sign * step * by for x, by in zip(rows[2:], moved, strict=True))) for sign in (-1, 1)]
        apart.append(np.abs((ends[1] - ends[0]) / (2 * step) - slope) / (np.abs(slope) + value))
    best, is_smooth = np.min(apart, 0), ~np.isnan(np.asarray(slope))
    assert is_smooth.mean() > 0.95
    assert best[is_smooth].max() < 0.01


@pytest.mark.slow
def test_what_asks_for_none_or_too_much():
    tripod = Grasp([[1.0, 0, 0], [-0.5, 0.8, 0], [-0.5, -0.8, 0]], [[0.0, 0, 1]] * 3, [0.5] * 3, [1.0] * 3)
    weight = jnp.array([0.0, 0, 3, 0, 0, 0])
    np.testing.assert_allclose(least_squeeze(tripod, weight), 3, rtol=1e-9)
    assert least_friction(tripod, weight, total=3.01) == 0
    assert least_friction(tripod, weight, total=2.99) == np.inf
    assert least_squeeze(tripod, -weight) == np.inf and least_friction(tripod, -weight) == np.inf
    assert least_squeeze(tripod, 0 * weight) == 0
    assert np.isnan(jax.grad(lambda w: least_squeeze(tripod, w))(-weight)).all()
    bad = Grasp(tripod.points, tripod.normals, jnp.array([0.5, jnp.nan, 0.5]), tripod.squeeze)
    assert least_squeeze(bad, weight) == np.inf


@pytest.mark.slow
def test_what_cannot_move_keeps_its_squeeze():
    """A contact of weight zero presses on, and that counts."""
    held = jnp.array([[1.0, 0, 0], [-1, 0, 0], [0, 0, -1]])
    grasp = Grasp(held, -held, jnp.full(3, 0.5), jnp.array([4.0, 4.0, 1.5]))
    np.testing.assert_allclose(least_squeeze(grasp, LIFT, jnp.array([1.0, 1.0, 0.0])), 1.5 + 0.5 / 0.5, rtol=1e-8)
    np.testing.assert_allclose(least_squeeze(grasp, LIFT, "uniform"), 2, rtol=1e-8)


@pytest.mark.slow
def test_absent_contacts_change_nothing():
    problem = P.problems("ordinary", 4, COUNT, seed=5)
    contacts = (problem.points, problem.normals, problem.friction, problem.squeeze)
    padded = [np.concatenate([x, np.full_like(x[:, :2], np.nan)], 1) for x in contacts]
    present = np.concatenate([np.ones((COUNT, 4)), np.zeros((COUNT, 2))], 1)
    # Where less friction balances nothing at all, its least share is found by halving, to a millionth.
    for question, digits in ((least_squeeze, 1e-7), (least_friction, 1e-6), (least_squeeze_factor, 1e-7)):
        expected = question(grasp_of(problem), problem.wrench)
        np.testing.assert_allclose(question(Grasp(*padded, present), problem.wrench), expected, rtol=digits)


@pytest.mark.slow
def test_the_least_friction_leaves_the_total_that_is_allowed():
    """With that much friction the hand needs just its total; or with a little less it holds the load by no force."""
    problem = P.problems("ordinary", 5, COUNT, seed=6)
    grasp, total = grasp_of(problem), problem.squeeze.sum(1)
    share = np.asarray(least_friction(grasp, problem.wrench))

    def needed(factor):
        friction = problem.friction * (share * factor)[:, None]
        return np.asarray(least_squeeze(Grasp(grasp.points, grasp.normals, friction, grasp.squeeze), problem.wrench))

    at, below = needed(1.0), needed(1 - 3e-6)
    # Where that friction is the least with which any force holds, its total lies on the edge and may stay unproven.
    proven = ~np.isnan(at)
    assert proven.mean() > 0.8
    exact = np.abs(at / total - 1) < 1e-8
    assert exact.mean() > 0.5
    assert (at <= total * (1 + 1e-8))[proven].all()
    assert (exact | np.isinf(below)).all()


@pytest.fixture(scope="module")
def shares():
    """Return problems, their shares, and the mask of shares that the boundary of the exertable wrenches determines."""
    made = P.problems("ordinary", 4, 64, seed=5)
    share = np.asarray(least_friction(grasp_of(made), made.wrench))
    just = made._replace(friction=made.friction * share[:, None] * (1 + 1e-5))
    needed = np.asarray(least_squeeze(grasp_of(just), made.wrench))
    return made, share, np.abs(needed / made.squeeze.sum(1) - 1) > 1e-3


@pytest.mark.slow
def test_a_share_falls_as_friction_grows_whatever_holds_it(shares):
    made, share, bounded = shares
    assert 5 < bounded.sum() < 40

    def scaled(by):
        grasp = Grasp(made.points, made.normals, made.friction * by[:, None], made.squeeze)
        return least_friction(grasp, made.wrench)

    unit = jnp.ones(len(share))
    value, forward = jax.jvp(scaled, (unit,), (unit,))
    np.testing.assert_allclose(forward, -value, rtol=1e-6)
    back = jax.grad(lambda by: jnp.sum(scaled(by)))(unit)
    np.testing.assert_allclose(back, -value, rtol=1e-6)


@pytest.mark.slow
def test_shares_at_a_boundary_move_as_differences_say(shares):
    made, share, bounded = shares
    rng = np.random.default_rng(0)
    moves = 0.02 * rng.normal(size=made.points.shape), 0.3 * rng.normal(size=made.wrench.shape) * np.abs(made.wrench)

    def moved(t):
        grasp = Grasp(made.points + t * moves[0], made.normals, made.friction, made.squeeze)
        return least_friction(grasp, made.wrench + t * moves[1])

    _, forward = jax.jvp(moved, (0.0,), (1.0,))
    coarse, fine = ((np.asarray(moved(h)) - np.asarray(moved(-h))) / (2 * h) for h in (3e-3, 1e-3))
    scale, unsure = np.abs(fine) + 0.01 * share, np.abs(coarse - fine)
    # Over a kink, where another facet takes over, differences do not agree with themselves.
    smooth = bounded & (unsure < 5e-3 * scale)
    assert smooth.sum() > 0.7 * bounded.sum()
    assert (np.abs(np.asarray(forward) - fine) < 1e-3 * scale + 2 * unsure)[smooth].all()


@pytest.mark.slow
@pytest.mark.parametrize("question", [least_squeeze, least_friction])
def test_derivatives_forward_reverse_and_by_differences(question):
    count = 8 * COUNT  # of a few, the ninth decile of the errors would be chance
    problem = P.problems("ordinary", 5, count, seed=7)
    inputs = (problem.points, problem.normals, problem.friction, problem.squeeze, problem.wrench)
    rng = np.random.default_rng(8)
    moved = tuple(0.1 * rng.normal(size=x.shape) * np.abs(x).mean() for x in inputs)
    f = jax.jit(lambda x: question(Grasp(*x[:4]), x[4]))
    # Of one solution: two programs without optimisation may round two of them 1e-9 apart.
    value, derivative = jax.linearize(f, inputs)
    tangent = derivative(moved)
    pull = rng.normal(size=count)
    (gradient,) = jax.linear_transpose(derivative, inputs)(pull)
    backward = sum(np.sum(g * m) for g, m in zip(gradient, moved, strict=True))
    np.testing.assert_allclose(backward, np.sum(pull * tangent), rtol=1e-9)
    errors = []
    for h in (1e-3, 1e-4):
        ahead = [
            np.asarray(f(tuple(x + k * h * m for x, m in zip(inputs, moved, strict=True)))) for k in (1, -1, 2, -2)
        ]
        slope = (8 * (ahead[0] - ahead[1]) - (ahead[2] - ahead[3])) / (12 * h)
        errors.append(np.abs(slope - tangent) / (np.abs(tangent) + 0.1 * np.abs(value)))
    error = np.min(errors, 0)
    if question is least_friction:
        # Not all are held by their squeeze: elsewhere less friction would leave the wrench out of reach.
        scaled = Grasp(*inputs[:2], inputs[2] * np.asarray(value)[:, None], inputs[3])
        exact = np.abs(np.asarray(least_squeeze(scaled, inputs[4])) / inputs[3].sum(1) - 1) < 1e-8
        assert 0.5 < exact.mean() < 1
        # Those shares are found by halving, to 1e-6, of which differences over 1e-3 make a thousandth.
        assert (error[~exact] < 5e-3).all()
        error = error[exact]
    # Some have a kink within the steps.
    assert np.quantile(error, 0.9) < 1e-6


@pytest.mark.parametrize("question", [least_squeeze, pytest.param(least_friction, marks=pytest.mark.slow)])
def test_second_derivatives_are_refused(question):
    with pytest.raises(NotImplementedError, match="first derivatives only"):
        # Tracing refuses it: nothing is compiled.
        jax.eval_shape(jax.hessian(lambda w: question(PINCH, w)), LIFT)


@pytest.mark.parametrize("n", [3, pytest.param(5, marks=pytest.mark.slow)])
def test_the_least_factor_is_where_method_b_comes_to_hold(n):
    problem = P.problems("ordinary", n, 400, seed=9)
    factor = np.asarray(least_squeeze_factor(grasp_of(problem), problem.wrench))

    def holds(factors):
        squeeze = problem.squeeze * factors[:, None]
        grasp = Grasp(problem.points, problem.normals, problem.friction, squeeze)
        return np.asarray(closed_form(grasp, problem.wrench).verdict) == Verdict.CLOSED_FORM_OPTIMAL

    is_finite = np.isfinite(factor) & (factor > 0)
    assert is_finite.mean() > 0.1 and np.isinf(factor).mean() > 0.1
    assert holds(np.where(is_finite, factor, 1) * (1 + 1e-7))[is_finite].all()
    assert not holds(np.where(is_finite, factor, 1) * (1 - 1e-7))[is_finite].any()
    for tried in np.geomspace(1e-3, 1e3, 25):
        held = holds(np.full(len(factor), tried))
        assert (factor[held] <= tried * (1 + 1e-9)).all()


@pytest.mark.slow
def test_the_least_factor_of_a_pinch_by_hand():
    np.testing.assert_allclose(least_squeeze_factor(PINCH, LIFT), 1 / (0.5 * 4), rtol=1e-12)
    by_friction = jax.grad(lambda mu: least_squeeze_factor(Grasp(PINCH.points, PINCH.normals, mu, PINCH.squeeze), LIFT))
    np.testing.assert_allclose(np.sum(by_friction(PINCH.friction)), -1, rtol=1e-9)
    assert least_squeeze_factor(PINCH, 0 * LIFT) == 0
    weak = Grasp(PINCH.points, PINCH.normals, jnp.zeros(2), PINCH.squeeze)
    assert least_squeeze_factor(weak, LIFT) == jnp.inf


@pytest.mark.parametrize("turn", [(0.0, 0.0, 0.0), (0.4, -1.1, 0.7)])
def test_the_least_factor_without_friction(turn):
    """Contacts that only press hold too: a support that must not let go, and contacts of both kinds."""
    turned = jnp.asarray(Rotation.from_rotvec(turn).as_matrix())
    along = jnp.concatenate([turned[:, 0], jnp.zeros(3)])
    pinch = PINCH.points @ turned.T
    still = Grasp(pinch, -pinch, jnp.zeros(2), jnp.ones(2))
    np.testing.assert_allclose(least_squeeze_factor(still, along), 0.5, rtol=1e-12)
    points = jnp.array([[1.0, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]]) @ turned.T
    mixed = Grasp(points, -points, jnp.array([0, 0, 0.5, 0.5]), jnp.array([1.0, 1, 2, 2]))
    # The load of 0.5 is shared as 1 to 2: those without friction keep pressing from x = 0.5 / 6 on, and of those with
    # it 0.5 * 2 x must hold 0.5 / 3.
    np.testing.assert_allclose(least_squeeze_factor(mixed, 0.5 * along), 1 / 6, rtol=1e-12)


def test_no_factor_holds_where_nothing_balances():
    points, normals, friction, squeeze = PINCH.points, PINCH.normals, PINCH.friction, PINCH.squeeze
    for grasp, wrench in (
        (Grasp(points, normals, friction, 0 * squeeze), LIFT),
        (Grasp(points, normals, friction, squeeze, jnp.zeros(2)), LIFT),
        (Grasp(points * jnp.nan, normals, friction, squeeze), LIFT),
        (Grasp(points, normals, -friction, squeeze), LIFT),
        (PINCH, jnp.array([0, 0, 1, 0.3, 0, 0])),
    ):
        assert least_squeeze_factor(grasp, wrench) == jnp.inf


@pytest.mark.slow
def test_where_a_share_is_zero_nothing_moves_and_where_none_will_do_there_is_no_derivative():
    def by_squeeze(question, squeeze, wrench):
        return jax.value_and_grad(lambda s: question(Grasp(PINCH.points, PINCH.normals, PINCH.friction, s), wrench))(
            squeeze
        )

    def reserve(grasp, wrench):
        return friction_reserve(grasp, wrench).reserve

    weak, strong = jnp.full(2, 4e-6), jnp.full(2, 4.0)
    for question, squeeze, wrench, expected in (
        (least_friction, weak, LIFT, jnp.inf),
        (reserve, weak, LIFT, 0),
        (least_friction, strong, 0 * LIFT, 0),
        (reserve, strong, 0 * LIFT, jnp.inf),
    ):
        value, slope = by_squeeze(question, squeeze, wrench)
        assert value == expected and (np.isnan(slope).all() if squeeze is weak else not np.any(slope))
    np.testing.assert_allclose(by_squeeze(reserve, strong, LIFT)[1], [0.25, 0.25], rtol=1e-6)
    assert least_friction(PINCH, 0 * LIFT, total=0.0) == 0
