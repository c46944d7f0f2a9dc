"""Functions compiled as one kernel: the same numbers, whatever is done to them."""

import re
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrasp.numerics.compiled_code import is_known_xla, merges_loops
from jaxgrasp.numerics.fused_cpu_kernel import LARGEST_REDUCTION, computed_once, fused_cpu_kernel, keep_separate

needs_known_xla = pytest.mark.skipif(
    not is_known_xla(), reason="a version or a device on which there are no such kernels"
)


def walk(x, terms, count, *, mirrored=False):
    """Run ``count`` steps of a function that loops, sums and chooses."""
    sign = -1 if mirrored else 1

    def step(_, x):
        return jnp.where(x > 0, jnp.sin(x), terms["scale"] * x) + sign * jnp.sum(x * terms["shift"], 0)

    moved = jax.lax.fori_loop(0, count, step, x)
    return {"end": moved, "way": moved - x, "far": jnp.sum(moved * moved) > 3}


kernel = fused_cpu_kernel(walk)
POINTS = jnp.asarray(np.random.default_rng(0).normal(size=(4, 16)))
TERMS = {"scale": jnp.asarray(0.3), "shift": jnp.linspace(-0.1, 0.1, 16)}


def small_calls(function, *arguments) -> int:
    text = jax.jit(function).lower(*arguments).compile().as_text()
    # XLA gives some loops of its own the second attribute.
    return len(re.findall(r" call\(.*inlineable=\"false\",xla_cpu_small_call", text))


@needs_known_xla
def test_it_is_one_kernel():
    assert small_calls(lambda x: kernel(x, TERMS, 3), POINTS) == 1
    assert small_calls(lambda x: walk(x, TERMS, 3), POINTS) == 0


@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.parametrize("count", [1, 4])
@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
def test_it_gives_the_same_numbers(count, mirrored, dtype):
    points, terms = jax.tree.map(lambda x: x.astype(dtype), (POINTS, TERMS))
    expected, result = (jax.jit(partial(f, count=count, mirrored=mirrored))(points, terms) for f in (walk, kernel))
    for name in expected:
        assert result[name].dtype == expected[name].dtype
        np.testing.assert_allclose(result[name], expected[name], rtol=100 * float(jnp.finfo(dtype).eps), atol=1e-12)


@needs_known_xla
def test_reshapes_do_not_grow_with_the_number_of_arguments():
    """In a chain of reshaped terms XLA moves one reshape a pass, of up to 50 passes over the whole program."""

    def reshapes(count: int) -> int:
        spread = fused_cpu_kernel(lambda arrays: [2 * array for array in arrays])
        return jax.jit(spread).lower([POINTS, POINTS[0]] * count).as_text().count("stablehlo.reshape")

    assert reshapes(20) == reshapes(1) > 0


@pytest.mark.parametrize("rows", [4, 400])
def test_what_a_program_holds_as_constants_is_read_too(rows):
    """XLA computes with constants beforehand, and aborts where a kernel then leaves an argument unused."""
    held = np.random.default_rng(1).normal(size=(rows, 5))
    spread = fused_cpu_kernel(lambda a, b: {"sum": 2 * a + b, "part": jnp.sum(a[:, 0]) * b[:, 1]})
    ones_array = np.ones_like(held)
    for result, (a, b) in (
        (jax.jit(lambda b: spread(held, b))(ones_array), (held, ones_array)),
        (jax.jit(lambda a: spread(a, held))(ones_array), (ones_array, held)),
        (jax.jit(lambda: spread(held, held))(), (held, held)),
    ):
        np.testing.assert_allclose(result["sum"], 2 * a + b, rtol=1e-15)
        np.testing.assert_allclose(result["part"], a[:, 0].sum() * b[:, 1], rtol=1e-12)


def test_mapped_and_differentiated_it_is_the_function_itself():
    def of(f):
        return lambda x, terms: jnp.sum(f(x, terms, 3)["end"] ** 2)

    many = jnp.stack([POINTS, 2 * POINTS, -POINTS])
    for derive in (jax.grad, jax.jacfwd, lambda f: jax.grad(lambda *a: jnp.sum(jax.grad(f)(*a)))):
        np.testing.assert_allclose(derive(of(kernel))(POINTS, TERMS), derive(of(walk))(POINTS, TERMS), rtol=1e-12)
    for transform in (jax.vmap, lambda f, axes: jax.vmap(jax.grad(f), axes)):
        mapped = [jax.jit(transform(of(f), (0, None)))(many, TERMS) for f in (kernel, walk)]
        np.testing.assert_allclose(*mapped, rtol=1e-12)


@needs_known_xla
def test_arguments_that_nothing_depends_on_are_no_harm():
    """XLA ends the process where a kernel leaves an argument unread."""
    idle = fused_cpu_kernel(lambda x, y, z: (x * 0 * 2, jnp.zeros_like(y), z - z))
    arguments = (POINTS, jnp.arange(3), jnp.asarray(True) | (jnp.arange(2) > 0) * 1)
    assert small_calls(idle, *arguments) == 1
    assert all(not np.any(x) for x in jax.jit(idle)(*arguments))


@needs_known_xla
@pytest.mark.parametrize(
    "foreign",
    [
        lambda x: jnp.sort(x, 1),
        lambda x: x @ x.T,
        lambda x: jax.ops.segment_sum(x, jnp.argmax(x, 1) % 3, 3),
        lambda x: jnp.linalg.cholesky(x @ x.T + jnp.eye(len(x))),
        lambda x: jnp.sum(jnp.broadcast_to(x, (LARGEST_REDUCTION, *x.shape)), 0),
        lambda x: jax.lax.fori_loop(0, 3, lambda _, y: jnp.sort(y, 0), x),
    ],
)
def test_what_it_cannot_hold_stays_as_it_is(foreign):
    assert small_calls(fused_cpu_kernel(foreign), POINTS) == 0
    np.testing.assert_allclose(jax.jit(fused_cpu_kernel(foreign))(POINTS), foreign(POINTS), rtol=1e-12)


def test_arrays_without_elements():
    nothing = jnp.zeros((0, 16))
    assert jax.jit(lambda x: kernel(x, TERMS, 2)["end"])(nothing).shape == (0, 16)


@needs_known_xla
def test_one_may_call_another():
    outer = fused_cpu_kernel(lambda x: kernel(kernel(x, TERMS, 1)["end"], TERMS, 2)["end"])
    expected = walk(walk(POINTS, TERMS, 1)["end"], TERMS, 2)["end"]
    np.testing.assert_allclose(jax.jit(outer)(POINTS), expected, rtol=1e-12)


def count_up(separate):
    """Return three steps of a loop whose body may be kept out of a larger kernel."""

    def step(i, x):
        i = keep_separate(i) if separate else i
        return jnp.sin(x) * i

    return jax.jit(lambda x: jax.lax.fori_loop(0, 3, step, x))


def test_a_loop_kept_separate_gives_the_same_numbers():
    np.testing.assert_array_equal(count_up(True)(POINTS), count_up(False)(POINTS))
    many = jnp.stack([POINTS, -POINTS])
    np.testing.assert_array_equal(jax.vmap(count_up(True))(many), jax.vmap(count_up(False))(many))


@pytest.mark.skipif(not merges_loops(), reason="this version of XLA makes no kernels of whole loops")
def test_a_loop_kept_separate_is_not_one_kernel():
    text = {is_separate: count_up(is_separate).lower(POINTS).compile().as_text() for is_separate in (True, False)}
    assert "xla_cpu_small_call" in text[False] and "xla_cpu_small_call" not in text[True]


def chain(x, *, is_cut: bool):
    """Return a chain of cheap steps, each of which reads the one before it several times."""
    for _ in range(5):
        x = jnp.where(x > 1, x * x - 2 * x, 3 * x + x * x)
        x = computed_once(x) if is_cut else x
    return x


@needs_known_xla
def test_what_is_computed_once_stands_in_one_loop_alone():
    def multiplications(is_cut: bool) -> int:
        ends = fused_cpu_kernel(lambda x: (chain(x, is_cut=is_cut) + 1, (chain(x, is_cut=is_cut) * 2).reshape(-1)))
        return jax.jit(ends).lower(POINTS).compile().as_text().count(" multiply(")

    assert multiplications(True) < multiplications(False)


def test_what_is_computed_once_is_the_same_and_has_derivatives():
    cut, plain = (lambda x: chain(x, is_cut=True)), (lambda x: chain(x, is_cut=False))
    for function in (lambda f: f, lambda f: jax.grad(lambda x: jnp.sum(f(x))), lambda f: jax.vmap(f)):
        expected = jax.jit(function(plain))(POINTS)
        for result in (jax.jit(function(cut))(POINTS), jax.jit(fused_cpu_kernel(function(cut)))(POINTS)):
            np.testing.assert_allclose(result, expected, rtol=1e-12)


@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
def test_what_is_computed_once_keeps_every_bit(dtype):
    info = jnp.finfo(dtype)
    some = np.random.default_rng(1).normal(size=(8, 10)) * 10.0 ** np.arange(-35, 35, 7)
    special = [0.0, -0.0, np.inf, -np.inf, np.nan, info.max, info.tiny, info.smallest_subnormal, 1 + info.eps, -1 / 3]
    numbers = jnp.asarray(np.concatenate([some, [special]]), dtype)
    kept = jax.jit(fused_cpu_kernel(lambda x: (computed_once(x), x.sum())))(numbers)[0]
    assert np.asarray(kept).tobytes() == np.asarray(numbers).tobytes()


def test_outside_of_kernels_nothing_is_cut():
    assert "computed_once" not in str(jax.make_jaxpr(partial(chain, is_cut=True))(POINTS))
