"""Cone programs judged by their own optimality conditions in NumPy, and beside Clarabel."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrasp.numerics.cone_program import ConeProgram, Cones, solve

B, K, M, D = 12, 6, 3, 3


@pytest.fixture(scope="module")
def program() -> ConeProgram:
    """Return a program that is feasible, as h - G x0 lies inside every cone and b = A x0, and bounded, as P > 0."""
    rng = np.random.default_rng(0)
    root, x0 = rng.normal(size=(B, K, K)), rng.normal(size=(B, K))
    rows, lines = rng.normal(size=(B, M, D, K)), rng.normal(size=(B, 2, 1, K))
    inside = rng.normal(size=(B, M, D)) * 0.3
    inside[..., 0] = np.linalg.norm(inside[..., 1:], axis=-1) + rng.uniform(0.1, 1, (B, M))
    equations = rng.normal(size=(B, 2, K))
    cones = (
        Cones(jnp.asarray(rows), jnp.asarray(inside + np.einsum("bmdk,bk->bmd", rows, x0))),
        Cones(jnp.asarray(lines), jnp.asarray(0.2 + np.einsum("bmdk,bk->bmd", lines, x0))),
    )
    quadratic = root @ root.transpose(0, 2, 1) / K
    arrays = (quadratic, rng.normal(size=(B, K)), equations, np.einsum("bek,bk->be", equations, x0))
    return ConeProgram(*map(jnp.asarray, arrays), cones)


@pytest.fixture(scope="module")
def solution(program):
    return jax.device_get(jax.jit(solve)(program))


@pytest.mark.parametrize("gives", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_all_are_solved_and_meet_the_optimality_conditions(program, solution, gives):
    p = jax.device_get(program)
    giving = np.zeros((B, M))
    if gives:
        giving = np.random.default_rng(1).uniform(0.1, 3, (B, M))
        soft = program._replace(cones=(program.cones[0]._replace(giving=jnp.asarray(giving)), program.cones[1]))
        rigid, solution = solution, jax.device_get(jax.jit(solve)(soft))
        # What presses gives way: otherwise this would be the rigid cones' program again.
        assert np.abs(solution.point - rigid.point).max() > 0.1
    assert solution.solved.all()
    x, y = solution.point, solution.equality
    np.testing.assert_allclose(np.einsum("bek,bk->be", p.equations, x), p.right, atol=1e-8)
    gradient = np.einsum("bkl,bl->bk", p.quadratic, x) + p.linear + np.einsum("bek,be->bk", p.equations, y)
    for cones, slack, dual in zip(p.cones, solution.slack, solution.duals, strict=True):
        cone_values = cones.offset - np.einsum("bmdk,bk->bmd", cones.rows, x)
        if cones is p.cones[0]:
            cone_values[..., 0] += giving * dual[..., 0]
        np.testing.assert_allclose(slack, cone_values, atol=1e-8)
        for side in (slack, dual):
            assert (np.linalg.norm(side[..., 1:], axis=-1) <= side[..., 0] + 1e-12).all()
        assert np.abs(np.sum(slack * dual, -1)).max() < 1e-8
        gradient = gradient + np.einsum("bmdk,bmd->bk", cones.rows, dual)
    assert np.abs(gradient).max() < 1e-8


def test_another_solver_finds_the_same(program, solution):
    clarabel = pytest.importorskip("clarabel")
    from scipy import sparse

    p = jax.device_get(program)
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = 1e-11
    for i in range(B):
        rows = [p.equations[i], *(cones.rows[i].reshape(-1, K) for cones in p.cones)]
        right = [p.right[i], *(cones.offset[i].ravel() for cones in p.cones)]
        kinds = [clarabel.ZeroConeT(2), *[clarabel.SecondOrderConeT(D)] * M, clarabel.NonnegativeConeT(2)]
        answer = clarabel.DefaultSolver(
            sparse.csc_matrix(np.triu(p.quadratic[i])),
            p.linear[i],
            sparse.csc_matrix(np.concatenate(rows)),
            np.concatenate(right),
            kinds,
            settings,
        ).solve()
        off = solution.point[i] - answer.x
        # The objective is quadratic: from the optimum it rises by half the square of the distance in P, and the gap
        # bounds by how much it may have.
        assert off @ p.quadratic[i] @ off / 2 <= solution.gap[i] + 1e-9
        ours, theirs = (x @ p.quadratic[i] @ x / 2 + p.linear[i] @ x for x in (solution.point[i], np.array(answer.x)))
        assert abs(ours - theirs) <= solution.gap[i] + 1e-8


def test_equations_that_depend_on_each_other_are_one(program, solution):
    doubled = program._replace(
        equations=jnp.concatenate([program.equations, program.equations[:, :1], 0 * program.equations[:, :1]], 1),
        right=jnp.concatenate([program.right, program.right[:, :1], 0 * program.right[:, :1]], 1),
    )
    again = jax.device_get(jax.jit(solve)(doubled))
    assert again.solved.all()
    np.testing.assert_allclose(again.point, solution.point, atol=1e-4)
