"""The margin of holding: its sign against Clarabel, its terms against definitions, continuity, derivatives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxgrasp
from jaxgrasp import Grasp, Verdict
from jaxgrasp.quality import hold_margin
from jaxgrasp.testing import problems as P
from jaxgrasp.testing.references import clarabel_optimum, tangents

COUNT, N = 64, 4
INPUTS = ("points", "normals", "friction", "squeeze", "wrench")
EVERYONE = np.ones((COUNT, N))


def grasp_of(problem: P.Problems) -> Grasp:
    return Grasp(problem.points, problem.normals, problem.friction, problem.squeeze, EVERYONE)


def margins(problem: P.Problems, weights: np.ndarray | None = None) -> np.ndarray:
    return np.asarray(hold_margin(grasp_of(problem), problem.wrench, problem.squeeze if weights is None else weights))


@pytest.mark.slow
@pytest.mark.parametrize("kind", [kind for kind in P.KINDS if kind != "zero_wrench"])
def test_the_sign_says_whether_forces_exist(kind):
    """Against Clarabel, and the verdict of the optimum. At zero load alone the margin is at its limit."""
    pytest.importorskip("clarabel")
    problem = P.problems(kind, N, COUNT, seed=1)
    margin = margins(problem)
    verdict = np.asarray(jaxgrasp.constrained_optimum(grasp_of(problem), problem.wrench, problem.squeeze).verdict)
    held = np.isin(verdict, [Verdict.CLOSED_FORM_OPTIMAL, Verdict.OPTIMAL, Verdict.FEASIBLE])
    assert (margin != 0).all() and ((margin > 0) == held)[verdict != Verdict.NOT_CONVERGED].all()
    if kind == "zero_squeeze":
        return
    status = np.array([clarabel_optimum(problem, problem.squeeze, i)[2] for i in range(COUNT)])
    assert (margin[status == "Solved"] > 0).all() and (margin[status == "PrimalInfeasible"] < 0).all()
    # Its own tolerances, at the end of its digits, leave some undecided.
    assert np.mean(np.isin(status, ["Solved", "PrimalInfeasible"])) > 0.05


def solved_by_clarabel(problem: P.Problems, i: int, cost: np.ndarray, of_margin: np.ndarray, free: bool, size=None):
    """Minimise cost over a number, the miss (6) and forces: the number in the balance, and the miss, if free.

    ``size`` scales the components of what is missed, whose length is the number then.
    """
    import clarabel
    from scipy import sparse

    n = N
    arms, normals, mu = problem.points[i], problem.normals[i], problem.friction[i]
    columns = np.concatenate([np.eye(3)[None].repeat(n, 0), np.cross(arms[:, None], np.eye(3)).transpose(0, 2, 1)], 1)
    balance = np.concatenate([of_margin[:, None], np.eye(6) * free, np.concatenate(list(columns), 1)], 1)
    rows, right, kinds = [balance], [problem.wrench[i]], [clarabel.ZeroConeT(6)]
    if free:
        away = np.zeros((7, 7 + 3 * n))
        away[0, 0] = -1
        away[1:, 1:7] = -size
        rows, right, kinds = [*rows, away], [*right, np.zeros(7)], [*kinds, clarabel.SecondOrderConeT(7)]
    else:
        cap = np.zeros((1, 7 + 3 * n))
        cap[0, 0] = 1
        fixed = np.zeros((6, 7 + 3 * n))
        fixed[:, 1:7] = np.eye(6)
        rows, right = [*rows, fixed, cap], [*right, np.zeros(6), np.ones(1)]
        kinds = [*kinds, clarabel.ZeroConeT(6), clarabel.NonnegativeConeT(1)]
    for k in range(n):
        cone = np.zeros((3, 7 + 3 * n))
        cone[:, 7 + 3 * k : 10 + 3 * k] = -np.vstack([mu[k] * normals[k], *tangents(normals[k])])
        rows, right, kinds = [*rows, cone], [*right, np.zeros(3)], [*kinds, clarabel.SecondOrderConeT(3)]
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    answer = clarabel.DefaultSolver(
        sparse.csc_matrix((7 + 3 * n, 7 + 3 * n)),
        np.concatenate([cost, np.zeros(3 * n)]),
        sparse.csc_matrix(np.concatenate(rows)),
        np.concatenate(right),
        kinds,
        settings,
    ).solve()
    assert str(answer.status) == "Solved"
    return answer.x[0]


def scales_of(problem: P.Problems, i: int):
    """Return |w| and the normal forces u of method B, and the matrix that brings a wrench to the metric's units."""
    share = problem.squeeze[i] / problem.squeeze[i].sum()
    centre = share @ problem.points[i]
    length = np.sqrt(share @ np.sum((problem.points[i] - centre) ** 2, -1))
    moved = np.eye(6)
    moved[3:, :3] = -np.cross(centre, np.eye(3)).T
    metric = np.diag([1, 1, 1, *[1 / length] * 3]) @ moved
    load = np.linalg.norm(metric @ problem.wrench[i])
    return load, problem.squeeze[i] + share * load, metric


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["infeasible", "limit_99", "ordinary"])
def test_its_terms_are_what_they_are_defined_as(kind):
    """The distance that is missed, the depth that is left, and the closed form's room."""
    pytest.importorskip("clarabel")
    problem = P.problems(kind, N, COUNT, seed=2)
    margin = margins(problem)
    closed = np.asarray(jaxgrasp.closed_form(grasp_of(problem), problem.wrench, problem.squeeze).forces)
    deep = 0
    for i in range(12):
        load, intended, metric = scales_of(problem, i)
        if kind == "infeasible":
            missed = solved_by_clarabel(problem, i, np.eye(7)[0], np.zeros(6), True, metric)
            np.testing.assert_allclose(margin[i], -missed / (problem.squeeze[i].sum() + load), rtol=1e-5)
            continue
        pushes = 0.1 * intended[:, None] * problem.normals[i]
        taken = np.concatenate([pushes.sum(0), np.cross(problem.points[i], pushes).sum(0)])
        depth = solved_by_clarabel(problem, i, -np.eye(7)[0], taken, False)
        along = np.sum(closed[i] * problem.normals[i], -1)
        across = np.linalg.norm(closed[i] - along[:, None] * problem.normals[i], axis=-1)
        mu = problem.friction[i]
        shares = np.minimum((mu * along - across) / np.sqrt(1 + mu**2), along) / intended
        room = -0.02 * np.log(np.exp(-shares / 0.02).sum())
        factor = 1 + room if room >= 0 else 1 / (1 - room)
        np.testing.assert_allclose(margin[i], depth * (2 - depth) * factor, rtol=1e-5)
        deep += depth > 1 - 1e-6
    assert deep > 6 if kind == "ordinary" else deep == 0


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "turning"), [("ordinary", 0.0), ("low_friction", 0.0), ("limit_99", 0.02)])
def test_margins_are_continuous_along_paths_across_all_borders(kind, turning):
    """Bisect each path towards its steepest part: a change that is no jump vanishes with the interval.

    Normals turn where all contacts push against a common motion, so that no grasp becomes force-closed.
    """
    problem = P.problems(kind, N, COUNT, seed=3)
    towards = np.random.default_rng(4).normal(size=problem.normals.shape)
    pull = -np.concatenate([problem.normals.sum(1), np.cross(problem.points, problem.normals).sum(1)], -1)
    pull *= problem.squeeze.sum(-1, keepdims=True)

    def at(share: np.ndarray) -> np.ndarray:
        """Return margins ``(64,)`` of loads that turn from the given one into a pull, as normals turn too."""
        share = share[:, None]
        turned = P.unit(problem.normals + turning * share[..., None] * towards)
        return margins(problem._replace(wrench=(1 - share) * problem.wrench + share * pull, normals=turned))

    places = np.linspace(0, 1, 65)
    values = np.stack([at(np.full(COUNT, place)) for place in places], -1)
    assert ((values > 0).any(-1) & (values < 0).any(-1)).mean() > 0.3
    steepest, lanes = np.abs(np.diff(values)).argmax(-1), np.arange(COUNT)
    low, high = places[steepest], places[steepest + 1]
    at_low, at_high = values[lanes, steepest], values[lanes, steepest + 1]
    for _ in range(24):
        middle = (low + high) / 2
        at_middle = at(middle)
        upper = np.abs(at_high - at_middle) > np.abs(at_middle - at_low)
        low, at_low = np.where(upper, middle, low), np.where(upper, at_middle, at_low)
        high, at_high = np.where(upper, high, middle), np.where(upper, at_high, at_middle)
    jump = np.abs(at_high - at_low)
    assert jump.max() < 1e-4, (np.flatnonzero(jump > 1e-4), at_low[jump > 1e-4], at_high[jump > 1e-4], low[jump > 1e-4])


@jax.jit
def moved_margins(inputs, tangents_in):
    """Compute the margin, its forward and its reverse derivative; compiled once for all tests."""

    def margin(points, normals, friction, squeeze, wrench):
        return hold_margin(Grasp(points, normals, friction, squeeze, EVERYONE), wrench, squeeze)

    value, forward = jax.linearize(margin, *inputs)
    return value, forward(*tangents_in), jax.linear_transpose(forward, *inputs)(jnp.ones_like(value))


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["ordinary", "low_friction", "infeasible", "limit_99"])
def test_derivatives_are_limits_of_differences(kind):
    problem = P.problems(kind, N, COUNT, seed=5)
    inputs = tuple(getattr(problem, name) for name in INPUTS)
    rng = np.random.default_rng(6)
    for name, size in zip(INPUTS, (0.02, 1.0, 1.0, 1.0, 5.0), strict=True):
        moved = tuple(
            size * rng.normal(size=x.shape) if field == name else np.zeros_like(x)
            for field, x in zip(INPUTS, inputs, strict=True)
        )
        value, tangent, pulled = jax.device_get(moved_margins(inputs, moved))
        best = np.full(COUNT, np.inf)
        for h in (1e-4, 1e-5, 1e-6):
            shifted = (
                problem._replace(**dict(zip(INPUTS, (a + q * h * b for a, b in zip(inputs, moved)), strict=True)))
                for q in (1, -1)
            )
            ahead, behind = (margins(end) for end in shifted)
            best = np.fmin(best, np.abs((ahead - behind) / (2 * h) - tangent) / (np.abs(tangent) + np.abs(value)))
        assert np.median(best) < 1e-6 and np.quantile(best, 0.9) < 1e-4, name
        reverse = sum(np.sum((p * m).reshape(COUNT, -1), -1) for p, m in zip(pulled, moved, strict=True))
        np.testing.assert_allclose(reverse, tangent, rtol=1e-8, atol=1e-9 * np.abs(tangent).max())


@pytest.mark.slow
@pytest.mark.parametrize("kind", P.KINDS)
def test_gradients_are_finite_everywhere(kind):
    problem = P.problems(kind, N, COUNT, seed=7)
    inputs = [getattr(problem, name).copy() for name in INPUTS]
    # Without contacts' friction, squeeze, load, and with all of them in one place.
    inputs[2][1], inputs[3][2], inputs[4][3], inputs[0][4] = 0, 0, 0, 0
    inputs[3][5], inputs[4][5] = 0, 0
    value, _, pulled = jax.device_get(moved_margins(tuple(inputs), tuple(map(np.zeros_like, inputs))))
    assert np.isfinite(value).all() and (value >= -1 - 1e-9).all() and (value <= 2).all()
    assert all(np.isfinite(part).all() for part in pulled)


BOX = np.array([[-0.03, 0, 0], [0.03, 0, 0], [-0.03, 0.01, 0.01], [-0.03, -0.01, -0.01]])
INWARD = np.array([[1.0, 0, 0], [-1, 0, 0], [1, 0, 0], [1, 0, 0]])
LIFT = np.array([0.0, 0, 2, 0, 0, 0])


def some(present, torsion=None) -> Grasp:
    """Return contacts of a box, of which some are there; NaN stands for the others."""
    gone = np.where(np.asarray(present) > 0, 0, np.nan)
    torsion = None if torsion is None else np.full(N, torsion)
    return Grasp(
        BOX + gone[:, None], INWARD, np.full(N, 0.5) + gone, np.full(N, 4.0), np.asarray(present, float), torsion
    )


@pytest.mark.slow
def test_straddling_is_not_rewarded():
    """Contacts of one side of a box cannot lift it, however many; one opposite is what counts."""
    one, two, three = (float(hold_margin(some(p), LIFT)) for p in ([1, 0, 0, 0], [1, 0, 1, 0], [1, 0, 1, 1]))
    opposite = float(hold_margin(some([1, 1, 0, 0]), LIFT))
    assert max(one, two, three) < -0.05 and opposite > 1
    # The way out of a straddle is uphill: towards the other side.
    slope = jax.grad(lambda normals: hold_margin(Grasp(BOX, normals, np.full(N, 0.5), np.full(N, 4.0)), LIFT))(
        jnp.asarray(np.tile([1.0, 0, 0], (N, 1)))
    )
    assert np.linalg.norm(slope) > 0.01


@pytest.mark.slow
def test_absent_contacts_and_bad_data_leave_others_alone():
    grasps = jax.tree.map(lambda *x: np.stack(x), *(some(p) for p in ([1, 1, 0, 0], [0, 0, 0, 0], [1, 1, 0, 0])))
    loads = np.stack([LIFT, LIFT, np.full(6, np.nan)])
    value, gradient = jax.value_and_grad(lambda g: jnp.nansum(hold_margin(g, loads)))(grasps)
    lone = np.asarray(hold_margin(grasps, loads))
    assert (
        lone[0] > 1 and abs(lone[1] + 1) < 1e-12 and np.isnan(lone[2]) and float(value) == pytest.approx(lone[:2].sum())
    )
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(gradient))
    assert (np.asarray(gradient.points)[0, 2:] == 0).all()


@pytest.mark.slow
def test_soft_fingers_resist_turning():
    turning = LIFT + np.array([0, 0, 0, 0.004, 0, 0])
    hard, soft = (float(hold_margin(some([1, 1, 0, 0], torsion), turning)) for torsion in (0.0, 0.005))
    assert hard < 0 < soft
    grasp = some([1, 1, 0, 0], 0.005)

    def margin(torsion):
        return hold_margin(Grasp(BOX, INWARD, np.full(N, 0.5), np.full(N, 4.0), grasp.present, torsion), turning)

    torsion, h = jnp.full(N, 0.005), 1e-7
    slope = np.asarray(jax.grad(margin)(torsion))
    np.testing.assert_allclose(slope.sum(), (margin(torsion + h) - margin(torsion - h)) / (2 * h), rtol=1e-5)
    assert (slope[2:] == 0).all() and slope[0] > 0


@pytest.mark.slow
def test_batches_mapped_axes_and_shared_grasps_agree():
    problem = P.problems("limit_99", N, COUNT, seed=8)
    grasp, one = grasp_of(problem), grasp_of(problem)[3]
    expected = np.asarray(hold_margin(grasp, problem.wrench))
    mapped = jax.jit(jax.vmap(jax.grad(lambda g, w: hold_margin(g, w), 1)))(grasp, problem.wrench)
    whole = jax.grad(lambda w: hold_margin(grasp, w).sum())(problem.wrench)
    np.testing.assert_allclose(mapped, whole, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(jax.vmap(hold_margin)(grasp, problem.wrench), expected, rtol=1e-9)
    shared = np.asarray(hold_margin(one, problem.wrench))
    np.testing.assert_allclose(shared[3], expected[3], rtol=1e-9)
    np.testing.assert_allclose(jax.vmap(hold_margin, (None, 0))(one, problem.wrench), shared, rtol=1e-9)


@pytest.mark.slow
def test_units_frames_and_single_precision_do_not_matter():
    problem = P.problems("ordinary", N, COUNT, seed=9)
    margin = margins(problem)
    force = problem._replace(squeeze=1e3 * problem.squeeze, wrench=1e3 * problem.wrench)
    np.testing.assert_allclose(margins(force), margin, rtol=1e-9)
    length = problem._replace(points=10 * problem.points, wrench=problem.wrench * [1, 1, 1, 10, 10, 10])
    np.testing.assert_allclose(margins(length), margin, rtol=1e-9)
    order = [2, 0, 3, 1]
    turned = problem._replace(**{name: getattr(problem, name)[:, order] for name in INPUTS[:4]})
    np.testing.assert_allclose(margins(turned), margin, rtol=1e-9)
    single = problem._replace(**{name: getattr(problem, name).astype(np.float32) for name in INPUTS})
    grasp = Grasp(single.points, single.normals, single.friction, single.squeeze)
    np.testing.assert_allclose(hold_margin(grasp, single.wrench), margin, rtol=5e-3)


@pytest.mark.slow
def test_second_derivatives_are_refused():
    problem = P.problems("ordinary", N, COUNT, seed=10)
    with pytest.raises(NotImplementedError, match="first derivatives only"):
        jax.hessian(lambda w: hold_margin(grasp_of(problem), w).sum())(problem.wrench)
