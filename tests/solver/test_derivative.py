"""Derivatives: forward, reverse and differences agree, and stay finite where the answer has a kink or is none.

Each compiled derivative serves a batch of ``COUNT`` problems, so that every law below costs one compilation.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxgrasp
from jaxgrasp import Grasp, Verdict
from jaxgrasp.testing import problems as P

COUNT, N = 64, 3
INPUTS = ("points", "normals", "friction", "squeeze", "wrench", "weights")
METHODS = {"closed": jaxgrasp.closed_form, "optimum": jaxgrasp.constrained_optimum}


def answers(method: str, inputs):
    """Return the differentiable fields as a function of all inputs."""
    points, normals, friction, squeeze, wrench, weights = inputs
    solution = METHODS[method](Grasp(points, normals, friction, squeeze), wrench, weights)
    return solution.forces, solution.multiplier, solution.objective


def loss(method: str, inputs, pull):
    return sum(jnp.vdot(p, a) for p, a in zip(pull, answers(method, inputs), strict=True))


class Compiled:
    """Value, forward and reverse derivative of one method, compiled once."""

    def __init__(self, method: str):
        self.method = method
        self.value = jax.jit(lambda x: answers(method, x))
        self.forward = jax.jit(lambda x, t: jax.jvp(lambda x: answers(method, x), (x,), (t,)))
        self.reverse = jax.jit(lambda x, pull: jax.grad(lambda x: loss(method, x, pull))(x))


@pytest.fixture(scope="module", params=METHODS)
def compiled(request) -> Compiled:
    return Compiled(request.param)


def inputs_of(problem: P.Problems, weights: np.ndarray | None = None):
    weights = problem.squeeze if weights is None else weights
    return (problem.points, problem.normals, problem.friction, problem.squeeze, problem.wrench, weights)


def steps(inputs, seed: int):
    """Return random directions of the size of each input."""
    rng = np.random.default_rng(seed)
    sizes = (0.05, 1.0, 1.0, 5.0, 1.0, 5.0)
    return tuple(size * rng.normal(size=x.shape) for size, x in zip(sizes, inputs, strict=True))


def anything_like(parts):
    """Return random cotangents; all ones would see only the sum of forces, which equilibrium fixes."""
    rng = np.random.default_rng(14)
    return tuple(rng.normal(size=np.shape(part)) for part in parts)


def only(name: str, moved):
    return tuple(m if name in (field, "all") else 0 * m for field, m in zip(INPUTS, moved, strict=True))


def along(inputs, moved, length: float):
    return tuple(x + length * m for x, m in zip(inputs, moved, strict=True))


def size_of(array: np.ndarray) -> np.ndarray:
    return np.abs(np.asarray(array).reshape(COUNT, -1)).max(-1)


def smooth_lanes(inputs, multiplier) -> np.ndarray:
    """Return True where all contacts are well away from their cones' surface and apex: no kink within a step."""
    points, normals, friction, squeeze, _, weights = inputs
    twist = multiplier[:, None, :3] + np.cross(multiplier[:, None, 3:], points)
    target = squeeze[..., None] * normals + weights[..., None] * twist
    along_normal = np.sum(target * normals, -1)
    across = np.linalg.norm(target - along_normal[..., None] * normals, axis=-1)
    size = np.linalg.norm(target, axis=-1)
    surface = np.abs(across - friction * along_normal) / size
    polar = np.abs(friction * across + along_normal) / size
    return (np.minimum(surface, polar).min(-1) > 0.1) & (across / size > 0.02).all(-1)


@pytest.fixture(scope="module")
def ordinary():
    return inputs_of(P.problems("ordinary", N, COUNT, seed=1))


@pytest.mark.parametrize("name", [*(pytest.param(name, marks=pytest.mark.slow) for name in INPUTS), "all"])
def test_forward_is_the_limit_of_differences(compiled, ordinary, name):
    """Sixth-order central differences, at three step lengths of which the best counts, lane by lane."""
    moved = only(name, steps(ordinary, seed=2))
    _, tangent = compiled.forward(ordinary, moved)
    at = [np.asarray(a) for a in compiled.value(ordinary)]
    lanes = smooth_lanes(ordinary, at[1]) if compiled.method == "optimum" else np.ones(COUNT, bool)
    assert lanes.sum() > COUNT / 4
    errors = []
    for h in (1e-3, 1e-4, 1e-5):
        far = [compiled.value(along(ordinary, moved, q * h)) for q in (-3, -2, -1, 1, 2, 3)]
        errors.append([])
        for field in range(3):
            a, b, c, d, e, f = (np.asarray(values[field]) for values in far)
            difference = (f - a - 9 * (e - b) + 45 * (d - c)) / (60 * h)
            scale = size_of(tangent[field]) + size_of(at[field])
            errors[-1].append(size_of(difference - tangent[field]) / scale)
    best = np.min(errors, 0)[:, lanes]
    assert best.max() < 1e-7
    assert np.median(best) < 1e-10
    if name not in ("friction",) or compiled.method == "optimum":
        assert size_of(tangent[0])[lanes].max() > 0  # a derivative that is always zero would pass otherwise


def test_closed_form_does_not_see_friction(ordinary):
    _, tangent = Compiled("closed").forward(ordinary, only("friction", steps(ordinary, seed=2)))
    assert all((np.asarray(t) == 0).all() for t in tangent)


def test_reverse_is_the_transpose_of_forward(compiled, ordinary):
    rng = np.random.default_rng(3)
    moved = steps(ordinary, seed=4)
    at, tangent = compiled.forward(ordinary, moved)
    pull = tuple(rng.normal(size=a.shape) / (1 + size_of(a).reshape(-1, *[1] * (a.ndim - 1))) for a in at)
    pulled = compiled.reverse(ordinary, pull)
    for name, m, p in zip(INPUTS, moved, pulled, strict=True):
        _, output_tangent = compiled.forward(ordinary, only(name, moved))
        forward = sum(
            np.sum((np.asarray(t) * q).reshape(COUNT, -1), -1) for t, q in zip(output_tangent, pull, strict=True)
        )
        reverse = np.sum((np.asarray(p) * m).reshape(COUNT, -1), -1)
        scale = sum(
            np.sum(np.abs(np.asarray(t) * q).reshape(COUNT, -1), -1) for t, q in zip(output_tangent, pull, strict=True)
        )
        assert (np.abs(forward - reverse) <= 1e-9 * (scale + np.abs(reverse))).all(), name


def test_derivatives_of_the_closed_form_are_exact(ordinary):
    """dF/dw is the weighted pseudo-inverse itself, and dq*/dw is the multiplier."""
    closed = Compiled("closed")
    for j in range(6):
        direction = np.zeros((COUNT, 6))
        direction[:, j] = 1
        moved = tuple(0 * x for x in ordinary[:4]) + (direction, 0 * ordinary[5])
        (_, multiplier, _), (forces, _, objective) = closed.forward(ordinary, moved)
        np.testing.assert_allclose(objective, multiplier[:, j], rtol=1e-9, atol=1e-9 * np.abs(multiplier).max())
        matrix = np.asarray(jaxgrasp.grasp_matrix(ordinary[0]))
        carried = np.einsum("bij,bj->bi", matrix, np.asarray(forces).reshape(COUNT, -1))
        np.testing.assert_allclose(carried, direction, atol=1e-10)


def test_value_of_the_optimum_moves_by_the_multiplier(ordinary):
    """The envelope theorem: d objective / d wrench = multiplier, cones active or not."""
    optimum = Compiled("optimum")
    pull = (np.zeros((COUNT, N, 3)), np.zeros((COUNT, 6)), np.ones(COUNT))
    gradient = optimum.reverse(ordinary, pull)[4]
    multiplier = np.asarray(optimum.value(ordinary)[1])
    error = size_of(gradient - multiplier) / size_of(multiplier)
    assert error.max() < 1e-6


def hessian_vector(method: str):
    @jax.jit
    def product(x, pull, t):
        return jax.jvp(jax.grad(lambda x: loss(method, x, pull)), (x,), (t,))

    return product


def check_hessian(method: str, ordinary):
    """Check that H v equals the difference of gradients, and v'H u = u'H v lane by lane."""
    compiled, product = Compiled(method), hessian_vector(method)
    rng = np.random.default_rng(5)
    at = [np.asarray(a) for a in compiled.value(ordinary)]
    pull = tuple(rng.normal(size=a.shape) / (1 + size_of(a).reshape(-1, *[1] * (a.ndim - 1))) for a in at)
    u, v = steps(ordinary, seed=6), steps(ordinary, seed=7)
    lanes = smooth_lanes(ordinary, at[1]) if method == "optimum" else np.ones(COUNT, bool)
    _, hv = product(ordinary, pull, v)
    _, hu = product(ordinary, pull, u)

    def inner(a, b):
        return sum(np.sum((np.asarray(p) * q).reshape(COUNT, -1), -1) for p, q in zip(a, b, strict=True))

    size = sum(np.sum(np.abs(np.asarray(p) * q).reshape(COUNT, -1), -1) for p, q in zip(hv, u, strict=True))
    assert (np.abs(inner(hv, u) - inner(hu, v)) <= 1e-6 * size)[lanes].all()
    h = 1e-5
    errors = []
    far = [compiled.reverse(along(ordinary, v, q * h), pull) for q in (-2, -1, 1, 2)]
    for field in range(len(INPUTS)):
        a, b, c, d = (np.asarray(values[field]) for values in far)
        difference = (a - 8 * b + 8 * c - d) / (12 * h)
        errors.append(size_of(difference - hv[field]) / (size_of(hv[field]) + size_of(b) + 1e-9))
    worst = np.asarray(errors)[:, lanes]
    assert worst.max() < 1e-3 and np.median(worst) < 1e-6
    assert inner(hv, u)[lanes].any()


@pytest.mark.slow
def test_hessian_vector_products_of_the_closed_form(ordinary):
    check_hessian("closed", ordinary)


@pytest.mark.slow
def test_hessian_vector_products_of_the_optimum(ordinary):
    check_hessian("optimum", ordinary)


@pytest.mark.slow
@pytest.mark.parametrize("uniform", [False, True])
def test_answers_are_homogeneous_in_wrench_and_squeeze(compiled, uniform):
    """Twice of both is twice the forces, so that along both the derivative is known exactly.

    It holds for every kind of problem, at kinks and where the active cones leave the dual's Hessian singular.
    """
    for kind in P.KINDS:
        problem = P.problems(kind, N, COUNT, seed=41)
        inputs = inputs_of(problem, np.ones_like(problem.squeeze) if uniform else None)
        along_both = tuple(m if name in ("squeeze", "wrench") else 0 * m for name, m in zip(INPUTS, inputs))
        at, tangent = compiled.forward(inputs, along_both)
        solution = METHODS[compiled.method](Grasp(*inputs[:4]), *inputs[4:])
        solved = np.asarray(solution.verdict) <= Verdict.OUTSIDE_CONES
        size = np.maximum(size_of(at[0]), size_of(problem.squeeze))
        forces = size_of(np.asarray(tangent[0]) - at[0])
        assert (forces <= 1e-6 * size)[solved].all(), kind
        # That of no force at all.
        price = np.sum(problem.squeeze**2 / np.where(inputs[5] > 0, inputs[5], np.inf), -1) / 2
        objective = np.abs(np.asarray(tangent[2]) - 2 * np.asarray(at[2]))
        assert (objective <= 1e-6 * (np.abs(at[2]) + price))[solved].all(), kind


def test_a_singular_hessian_leaves_the_multiplier_in_proportion():
    """Without friction a contact resists along its normal alone, and three leave three of six directions free."""
    optimum = Compiled("optimum")
    problem = P.problems("zero_friction", N, COUNT, seed=42)
    inputs = inputs_of(problem)
    relative = tuple(size_of(x).reshape(-1, *[1] * (x.ndim - 1)) * s / 5 for x, s in zip(inputs, steps(inputs, 43)))
    at, tangent = optimum.forward(inputs, relative)
    assert (size_of(tangent[1]) <= 1e8 * size_of(at[1])).all()


def with_bad_lanes(ordinary):
    """Return ordinary problems with an infeasible and three invalid ones among them."""
    rows = [x.copy() for x in ordinary]
    hopeless = inputs_of(P.problems("infeasible", N, 2, seed=8))
    for row, hopeless_row in zip(rows, hopeless, strict=True):
        row[[5, 50]] = hopeless_row
    rows[0][7, 1, 0] = np.nan
    rows[4][20, 2] = np.inf
    rows[2][30, 0] = -1.0
    bad = np.isin(np.arange(COUNT), [7, 20, 30])
    return tuple(rows), bad, np.isin(np.arange(COUNT), [5, 50])


def is_nan(array) -> np.ndarray:
    return np.isnan(np.asarray(array)).reshape(COUNT, -1)


def test_unanswerable_problems_have_no_derivative(compiled, ordinary):
    rows, invalid, hopeless = with_bad_lanes(ordinary)
    silent = invalid | hopeless if compiled.method == "optimum" else invalid
    moved = steps(ordinary, seed=9)
    _, tangent = compiled.forward(rows, moved)
    _, clean = compiled.forward(ordinary, moved)
    pull = anything_like(tangent)
    pulled, clean_pulled = compiled.reverse(rows, pull), compiled.reverse(ordinary, pull)
    untouched = ~(invalid | hopeless)
    for got, expected in zip((*tangent, *pulled), (*clean, *clean_pulled), strict=True):
        got, expected = np.asarray(got), np.asarray(expected)
        assert is_nan(got)[silent].all() and not is_nan(got)[~silent].any()
        assert (np.abs(got - expected) <= 1e-9 * np.abs(expected).max()).reshape(COUNT, -1).all(-1)[untouched].all()


def test_what_does_not_ask_for_a_missing_derivative_gets_zero(compiled, ordinary):
    """Neither a problem that does not move, nor a loss that leaves it out, though its data are NaN."""
    rows, invalid, hopeless = with_bad_lanes(ordinary)
    silent = invalid | hopeless if compiled.method == "optimum" else invalid

    def calm(parts):
        return tuple(np.where(silent.reshape(-1, *[1] * (np.ndim(part) - 1)), 0, part) for part in parts)

    _, tangent = compiled.forward(rows, calm(steps(ordinary, seed=9)))
    pulled = compiled.reverse(rows, calm(anything_like(tangent)))
    for part in (*tangent, *pulled):
        assert np.isfinite(part).all() and (np.asarray(part)[silent] == 0).all()


@pytest.mark.parametrize("kind", ["invalid", "infeasible"])
def test_a_batch_of_nothing_else(compiled, ordinary, kind):
    """No neighbour lends its branch: every problem of the batch is unanswerable."""
    if kind == "invalid":
        rows = (np.full_like(ordinary[0], np.nan), *ordinary[1:])
    else:
        rows = inputs_of(P.problems("infeasible", N, COUNT, seed=8))
    _, tangent = compiled.forward(rows, steps(ordinary, seed=9))
    pulled = compiled.reverse(rows, anything_like(tangent))
    none = kind == "invalid" or compiled.method == "optimum"
    for part in (*tangent, *pulled):
        assert is_nan(part).all() if none else np.isfinite(part).all()


@pytest.mark.slow
@pytest.mark.optimized
def test_loads_that_rounding_hides_keep_their_slope(ordinary):
    """Forces of the optimum, called FEASIBLE, move with the wrench; those found without squeezing do not say how."""
    optimum = Compiled("optimum")
    moved = only("wrench", steps(ordinary, seed=9))
    matrix = np.asarray(jaxgrasp.grasp_matrix(ordinary[0]))
    for share in (1e-9, 1e-12):
        rows = (*ordinary[:4], share * ordinary[4], ordinary[5])
        solution = jaxgrasp.constrained_optimum(Grasp(*rows[:4]), rows[4])
        hidden = np.asarray(solution.verdict) == Verdict.FEASIBLE
        squeezed = size_of(solution.forces) > 1e-3 * size_of(rows[3])
        assert (hidden & squeezed).sum() > COUNT / 4
        _, (forces, _, _) = optimum.forward(rows, moved)
        carried = np.einsum("bij,bj->bi", matrix, np.asarray(forces).reshape(COUNT, -1))
        np.testing.assert_allclose(carried[hidden & squeezed], moved[4][hidden & squeezed], atol=1e-9)
        assert is_nan(forces)[hidden & ~squeezed].all()


@pytest.mark.parametrize("kind", ["zero_squeeze", "some_zero_squeeze", "zero_friction", "zero_wrench"])
def test_kinks_of_the_data_are_finite(compiled, kind):
    """Apex, zero tangential force, zero squeeze: the double ``where`` at work."""
    problem = P.problems(kind, N, COUNT, seed=10)
    for weights in (problem.squeeze, np.ones_like(problem.squeeze)):
        rows = inputs_of(problem, weights)
        _, tangent = compiled.forward(rows, steps(rows, seed=11))
        pulled = compiled.reverse(rows, anything_like(tangent))
        assert all(np.isfinite(part).all() for part in (*tangent, *pulled))


def symmetric_triangle():
    """Return contacts whose closed form is purely normal, whatever wrench along the axis is added."""
    angle = np.arange(3) * 2 * np.pi / 3
    points = np.stack([np.cos(angle), np.sin(angle), 0 * angle], -1)
    return points, -points


def test_kinks_of_the_answer_are_finite(compiled):
    """Zero tangential force; a force on the cone's surface; all forces at the apex; coincident contacts."""
    points, normals = symmetric_triangle()
    rows = [np.broadcast_to(x, (COUNT, *x.shape)).copy() for x in (points, normals)]
    friction, squeeze = np.full((COUNT, 3), 0.5), np.full((COUNT, 3), 4.0)
    wrench = np.zeros((COUNT, 6))
    wrench[1::4, 2] = 6.0  # 2 N up at each contact, 4 N of normal force, mu 0.5: exactly on the surface
    squeeze[2::4] = 0.0  # nothing to do and nothing wanted: the apex
    rows[0][3::4] = points[0]  # one point
    inputs = (*rows, friction, squeeze, wrench, np.ones((COUNT, 3)))
    _, tangent = compiled.forward(inputs, steps(inputs, seed=12))
    pulled = compiled.reverse(inputs, anything_like(tangent))
    assert all(np.isfinite(part).all() for part in (*tangent, *pulled))
    # At a kink one element of the generalised Jacobian: forces still move so as to balance the wrench.
    moved = only("wrench", steps(inputs, seed=12))
    _, (forces, _, _) = compiled.forward(inputs, moved)
    full_rank = np.arange(COUNT) % 4 == 0
    carried = np.einsum("ij,bj->bi", np.asarray(jaxgrasp.grasp_matrix(points)), np.asarray(forces).reshape(COUNT, -1))
    np.testing.assert_allclose(carried[full_rank], moved[4][full_rank], atol=1e-9)


def test_absent_contacts_have_zero_derivative():
    # Four of five stay: a pair could not balance the wrench, and would have no derivatives at all.
    problem = P.problems("ordinary", 5, COUNT, seed=13)
    grasp = Grasp(problem.points.copy(), problem.normals, problem.friction, problem.squeeze, np.ones((COUNT, 5)))
    grasp.present[:, 1] = 0
    grasp.points[:, 1] = grasp.normals[:, 1] = np.nan

    @jax.jit
    def pulled(grasp, wrench):
        return jax.grad(lambda g: (jaxgrasp.closed_form(g, wrench, g.squeeze).forces ** 2).sum())(grasp)

    gradient = pulled(grasp, problem.wrench)
    for field in (gradient.points, gradient.normals, gradient.friction, gradient.squeeze, gradient.present):
        field = np.asarray(field)
        assert np.isfinite(field).all() and (field[:, 1] == 0).all()
    assert np.abs(gradient.points).max() > 0


@pytest.mark.slow
def test_nested_vmaps_differentiate_alike(compiled, ordinary):
    """Reverse mode inside vmap of vmap equals the batch's own."""
    square = tuple(x.reshape(8, 8, *x.shape[1:]) for x in ordinary)

    def single(*x):
        # Not the plain sum: equilibrium fixes that, and its derivatives are zero.
        return jax.grad(lambda x: (answers(compiled.method, x)[0] ** 2).sum())(x)

    nested = jax.jit(jax.vmap(jax.vmap(single)))(*square)
    pull = (2 * np.asarray(compiled.value(ordinary)[0]), np.zeros((COUNT, 6)), np.zeros(COUNT))
    for got, expected in zip(nested, compiled.reverse(ordinary, pull), strict=True):
        got, expected = np.asarray(got).reshape(np.shape(expected)), np.asarray(expected)
        assert (size_of(got - expected) <= 1e-9 * (1 + size_of(expected))).all()


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS)
def test_other_transformations_differentiate_alike(method, ordinary):
    """Linearisation, checkpoints and scans around one problem give the batch's own derivative."""
    inputs = tuple(x[:4] for x in ordinary)
    moved = tuple(x[:4] for x in steps(ordinary, seed=15))

    def forces(x):
        return answers(method, x)[0]

    expected = jax.jvp(forces, (inputs,), (moved,))[1]

    def linear(x, t):
        return jax.linearize(forces, x)[1](t)

    def checkpointed(x, t):
        return jax.jvp(jax.checkpoint(forces), (x,), (t,))[1]

    def scanned(x, t):
        return jax.jvp(lambda x: jax.lax.map(forces, x), (x,), (t,))[1]

    for got in (jax.jit(jax.vmap(linear))(inputs, moved), checkpointed(inputs, moved), jax.jit(scanned)(inputs, moved)):
        np.testing.assert_allclose(got, expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())
    column = jax.jit(jax.vmap(jax.jacrev(forces)))(inputs)[4]
    np.testing.assert_allclose(column, jax.jit(jax.vmap(jax.jacfwd(forces)))(inputs)[4], rtol=1e-8, atol=1e-9)


def test_verdicts_of_the_samples(ordinary):
    """The laws above were tried on both kinds of answer."""
    solution = jaxgrasp.constrained_optimum(Grasp(*ordinary[:4]), ordinary[4], ordinary[5])
    assert {int(v) for v in np.asarray(solution.verdict)} == {Verdict.CLOSED_FORM_OPTIMAL, Verdict.OPTIMAL}


def one_sided(value, inputs, step, size: float):
    """Return the one-sided derivative along ``step`` from ``inputs``, to second order."""
    value_here, near, far = (
        value(tuple(x + h * t for x, t in zip(inputs, step, strict=True))) for h in (0, size, 2 * size)
    )
    return [(4 * b - 3 * a - c) / (2 * size) for a, b, c in zip(value_here, near, far, strict=True)]


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS)
def test_a_weight_of_zero_has_its_one_sided_derivative(method):
    """Growing from nothing, a contact moves forces and objective: with its squeeze by method B, or alone."""
    problem = P.problems("ordinary", 5, COUNT, seed=31)
    value = jax.jit(lambda x: answers(method, x))
    forward = jax.jit(lambda x, t: jax.jvp(lambda x: answers(method, x), (x,), (t,))[1])
    grow = np.zeros_like(problem.squeeze)
    grow[:, 0] = 1
    bare = np.where(grow > 0, 0, problem.squeeze)
    for squeeze, growth in ((bare, grow), (problem.squeeze, 0 * grow)):
        inputs = inputs_of(problem._replace(squeeze=squeeze), bare)
        step = (*(np.zeros_like(x) for x in inputs[:3]), growth, np.zeros_like(problem.wrench), grow)
        forces, _, objective = forward(inputs, step)
        expected = one_sided(value, inputs, step, 1e-6)
        grasp = Grasp(problem.points, problem.normals, problem.friction, squeeze)
        solvable = np.asarray(METHODS[method](grasp, problem.wrench, bare).verdict) <= Verdict.OUTSIDE_CONES
        off = np.abs(forces - expected[0]).max((1, 2)) / (1 + np.abs(expected[0]).max((1, 2)))
        drift = np.abs(objective - expected[2]) / (1 + np.abs(expected[2]))
        assert solvable.mean() > 0.7
        assert off[solvable].max() < 1e-5 and drift[solvable].max() < 1e-5


def test_a_contact_without_friction_pushes_along_its_normal_alone(compiled):
    """A target on the normal is a smooth point there: the cone is a ray."""
    if compiled.method == "closed":
        pytest.skip("friction is not imposed")
    problem = P.problems("ordinary", N, COUNT, seed=32)
    points = np.broadcast_to([[1.0, 0, 0], [-1.0, 0, 0], [0, 0, -1.0]], problem.points.shape).copy()
    friction = np.broadcast_to([0.75, 0.75, 0.0], problem.friction.shape).copy()
    wrench = np.broadcast_to([0.0, 0, 2, 0, 0, 0], problem.wrench.shape).copy()
    squeeze = np.full_like(friction, 4.0)
    problem = problem._replace(points=points, normals=-points, friction=friction, squeeze=squeeze, wrench=wrench)
    inputs = inputs_of(problem)
    step = [np.zeros_like(x) for x in inputs]
    step[4] = np.broadcast_to([0.0, 1.0, 0, 0, 0, 0], wrench.shape).copy()
    _, (forces, _, _) = compiled.forward(inputs, tuple(step))
    np.testing.assert_allclose(forces[:, 2, :2], 0, atol=1e-12)
    expected = one_sided(compiled.value, inputs, step, 1e-5)[0]
    np.testing.assert_allclose(forces, expected, atol=1e-8)
