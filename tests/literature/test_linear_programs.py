"""The three linear programs: optima as Clarabel has them, limits, the compact dual, and how both turn and scale."""

import numpy as np
import pytest

from jaxgrasp import Grasp, GraspError, Limits
from jaxgrasp.literature import MethodStatus, cheng_orin, kerr_roth, orin_oh
from jaxgrasp.literature.linear import LinearProgram, sizes_of, solve_compact_dual, solve_plain
from jaxgrasp.literature.method_input import read_input
from jaxgrasp.literature.orin_oh import load_program
from jaxgrasp.literature.scaled_problems import host_problem, scale
from jaxgrasp.testing import problems as P

COUNT, N, SIDES, MOST = 10, 4, 6, 200.0
JOINTS = 3


def grasp_of(problem: P.Problems) -> Grasp:
    return Grasp(*problem[1:5])


def edges(normals: np.ndarray, friction: np.ndarray, sides: int = SIDES) -> np.ndarray:
    """Return edges ``(n, sides, 3)`` on the cone, the first towards a x e, e the axis farthest from the normal a."""
    first = P.unit(np.cross(normals, np.eye(3)[np.argmin(np.abs(normals), -1)]))
    angle = (2 * np.pi * np.arange(sides) / sides)[:, None]
    around = np.cos(angle) * first[:, None] + np.sin(angle) * np.cross(normals, first)[:, None]
    return normals[:, None] + friction[:, None, None] * around


def planes(normals: np.ndarray, friction: np.ndarray) -> np.ndarray:
    """Return inward unit normals ``(n, sides, 3)`` of the planes through neighbouring edges."""
    corner = edges(normals, friction)
    across = P.unit(np.cross(corner, np.roll(corner, -1, 1)))
    return across * np.sign(np.sum(across * normals[:, None], -1, keepdims=True))


def scaled_balance(problem: P.Problems, i: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the balance of force, and torque about the contacts' middle over 5 cm: matrix ``(6, 3n)`` and load."""
    middle = problem.points[i].mean(0)
    arms = (problem.points[i] - middle) / 0.05
    matrix = np.concatenate([np.concatenate([np.eye(3), np.cross(r, np.eye(3)).T]) for r in arms], 1)
    force, torque = problem.wrench[i, :3], problem.wrench[i, 3:]
    return matrix, np.concatenate([force, (torque - np.cross(middle, force)) / 0.05])


def clarabel_linear(cost, equal, right, rows, bounds) -> float:
    """Return the least cost with equal x = right and rows x <= bounds, by an interior-point method."""
    import clarabel
    from scipy import sparse

    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = 1e-10
    kinds = [clarabel.ZeroConeT(len(right)), clarabel.NonnegativeConeT(len(bounds))]
    matrix = sparse.csc_matrix(np.concatenate([equal, rows]))
    nothing = sparse.csc_matrix((len(cost), len(cost)))
    answer = clarabel.DefaultSolver(nothing, cost, matrix, np.concatenate([right, bounds]), kinds, settings).solve()
    assert str(answer.status) in ("Solved", "AlmostSolved")
    return float(answer.obj_val)


@pytest.fixture(scope="module")
def problem() -> P.Problems:
    return P.problems("ordinary", N, COUNT, seed=11)


@pytest.fixture(scope="module")
def torque_map() -> np.ndarray:
    return np.random.default_rng(3).normal(0, 0.05, (COUNT, N, 3, JOINTS))


def test_kerr_roth_is_the_farthest_from_all_planes(problem):
    answer = kerr_roth(grasp_of(problem), problem.wrench, limits=Limits(normal_max=np.full(N, MOST)), sides=SIDES)
    assert (answer.status == MethodStatus.SOLVED).all()
    for i in range(COUNT):
        inward = planes(problem.normals[i], problem.friction[i])
        forces, normals = answer.forces[i], problem.normals[i]
        pressed = np.sum(forces * normals, -1)
        distance = min((inward @ forces[..., None]).min(), pressed.min(), (MOST - pressed).min())
        assert distance == pytest.approx(answer.objective[i], rel=1e-6, abs=1e-6)
        # Unknown forces and the distance d, which every plane must leave.
        matrix, load = scaled_balance(problem, i)
        slopes = np.zeros((N, SIDES + 1, N, 3))
        for c in range(N):
            slopes[c, :SIDES, c], slopes[c, SIDES, c] = -inward[c], normals[c]
        rows = np.column_stack([slopes.reshape(-1, 3 * N), np.ones(N * (SIDES + 1))])
        bounds = np.tile([0.0] * SIDES + [MOST], N)
        cost = np.eye(3 * N + 1)[-1] * -1
        best = -clarabel_linear(cost, np.column_stack([matrix, np.zeros(6)]), load, rows, bounds)
        assert answer.objective[i] == pytest.approx(best, rel=1e-6)


def least_load(problem, i, most=None, torque_map=None) -> float:
    """Solve Orin and Oh's program with forces as nonnegative sums of edges: no facet is written down."""
    matrix, load = scaled_balance(problem, i)
    spread = np.zeros((3 * N, N * SIDES))
    for c, corner in enumerate(edges(problem.normals[i], problem.friction[i])):
        spread[3 * c : 3 * c + 3, c * SIDES : (c + 1) * SIDES] = corner.T
    size, joints = N * SIDES, 0 if torque_map is None else JOINTS
    pressed = np.kron(np.eye(N), np.ones(SIDES))
    cost = np.concatenate([np.zeros(size) if joints else np.ones(size), np.ones(joints), [1.0]])
    rows = [np.column_stack([-np.eye(size), np.zeros((size, joints + 1))])]
    rows.append(np.column_stack([pressed, np.zeros((N, joints)), -np.ones(N)]))
    bounds = [np.zeros(size), np.zeros(N)]
    if joints:
        torques = np.einsum("ncj,ncs->js", torque_map[i], spread.reshape(N, 3, size))
        rows += [np.column_stack([sign * torques, -np.eye(joints), np.zeros(joints)]) for sign in (1, -1)]
        bounds += [np.zeros(joints)] * 2
    if most is not None:
        rows.append(np.column_stack([pressed, np.zeros((N, joints + 1))]))
        bounds.append(np.full(N, most))
    equal = np.column_stack([matrix @ spread, np.zeros((6, joints + 1))])
    return clarabel_linear(cost, equal, load, np.concatenate(rows), np.concatenate(bounds))


@pytest.mark.parametrize("method", [orin_oh, cheng_orin])
def test_orin_oh_is_the_least_of_effort_and_load(problem, torque_map, method):
    plain = method(grasp_of(problem), problem.wrench, sides=SIDES)
    moved = method(grasp_of(problem), problem.wrench, sides=SIDES, limits=Limits(torque_map=torque_map))
    assert (plain.status == MethodStatus.SOLVED).all() and (moved.status == MethodStatus.SOLVED).all()
    for i in range(COUNT):
        pressed = np.sum(plain.forces[i] * problem.normals[i], -1)
        assert plain.objective[i] == pytest.approx(pressed.sum() + pressed.max(), rel=1e-7)
        assert plain.objective[i] == pytest.approx(least_load(problem, i), rel=1e-6)
        efforts = np.abs(np.einsum("ncj,nc->j", torque_map[i], moved.forces[i]))
        largest = np.sum(moved.forces[i] * problem.normals[i], -1).max()
        assert moved.objective[i] == pytest.approx(efforts.sum() + largest, rel=1e-7)
        assert moved.objective[i] == pytest.approx(least_load(problem, i, torque_map=torque_map), rel=1e-6)


@pytest.mark.parametrize("method", [kerr_roth, orin_oh, cheng_orin])
def test_limits_are_respected(problem, torque_map, method):
    free = orin_oh(grasp_of(problem), problem.wrench)
    pressed = np.sum(free.forces * problem.normals, -1)
    torques = np.abs(np.einsum("bncj,bnc->bj", torque_map, free.forces)).max(-1, keepdims=True)
    limits = Limits(
        normal_min=np.full((COUNT, N), 0.05 * pressed.mean()),
        normal_max=np.broadcast_to(3 * pressed.max(-1, keepdims=True), (COUNT, N)),
        torque_map=torque_map,
        torque_max=np.broadcast_to(1.5 * torques, (COUNT, JOINTS)),
    )
    answer = method(grasp_of(problem), problem.wrench, limits=limits)
    good = answer.status == MethodStatus.SOLVED
    assert good.sum() > COUNT / 2 and set(answer.status[~good].tolist()) <= {MethodStatus.INFEASIBLE}
    normal_forces = np.sum(answer.forces * problem.normals, -1)[good]
    assert (normal_forces >= limits.normal_min - 1e-5).all() and (
        normal_forces <= limits.normal_max[good] * (1 + 1e-7)
    ).all()
    moved = np.abs(np.einsum("bncj,bnc->bj", torque_map, answer.forces))[good]
    assert (moved <= limits.torque_max[good] * (1 + 1e-6)).all()


def test_kerr_roth_without_a_bound_on_every_force_is_unbounded(problem, torque_map):
    loose = Limits(torque_map=0 * torque_map, torque_max=np.ones((COUNT, JOINTS)))
    answer = kerr_roth(grasp_of(problem), problem.wrench, limits=loose)
    held = answer.status == MethodStatus.SOLVED
    assert (answer.status[~held] == MethodStatus.UNBOUNDED).all() and (~held).any()


def test_circumscribed_pyramids_hold_more_and_may_slip(problem):
    inner, outer = (orin_oh(grasp_of(problem), problem.wrench, pyramid=kind) for kind in ("inscribed", "circumscribed"))
    assert (outer.objective <= inner.objective * (1 + 1e-9)).all()
    along = np.sum(outer.forces * problem.normals, -1)
    across = np.linalg.norm(outer.forces - along[..., None] * problem.normals, axis=-1)
    beyond = across - problem.friction * along
    assert beyond.max() > 1e-3
    assert (beyond <= (1 / np.cos(np.pi / 8) - 1) * problem.friction * along + 1e-6).all()


@pytest.mark.parametrize("method", [orin_oh, cheng_orin])
def test_forces_scale_with_the_load(problem, method):
    light, many = (method(grasp_of(problem), size * problem.wrench) for size in (1.0, 1e4))
    np.testing.assert_allclose(many.objective, 1e4 * light.objective, rtol=1e-6)


def test_all_turn_with_a_frame_whose_axes_change_places(problem):
    """Pyramids hang on the coordinate axes, so that only such a frame turns them too."""
    limits = Limits(normal_max=np.full(N, MOST))
    turned = Grasp(*(np.roll(x, 1, -1) for x in problem[1:3]), *problem[3:5])
    wrench = np.concatenate([np.roll(problem.wrench[:, :3], 1, -1), np.roll(problem.wrench[:, 3:], 1, -1)], -1)
    for method in (kerr_roth, orin_oh, cheng_orin):
        answer = method(grasp_of(problem), problem.wrench, limits=limits)
        turned_answer = method(turned, wrench, limits=limits)
        np.testing.assert_allclose(turned_answer.objective, answer.objective, rtol=1e-6)


@pytest.mark.parametrize("kind", ["ordinary", "near_collinear", "coincident_some", "zero_wrench", "infeasible"])
@pytest.mark.parametrize("n", [2, 3, 6])
def test_the_compact_dual_finds_the_plain_optimum(kind, n):
    problem = P.problems(kind, n, 8, seed=4)
    plain, compact = (method(grasp_of(problem), problem.wrench) for method in (orin_oh, cheng_orin))
    np.testing.assert_array_equal(compact.status, plain.status)
    np.testing.assert_allclose(compact.objective, plain.objective, rtol=1e-6, atol=1e-6)


def test_the_compact_dual_knows_unbounded_from_infeasible():
    rng = np.random.default_rng(0)
    equal, inside = rng.normal(size=(2, 5)), rng.normal(size=5)
    rows = rng.normal(size=(3, 5))
    falling = LinearProgram(rng.normal(size=5), equal, equal @ inside, rows, rows @ inside + 1)
    cases = [(falling, MethodStatus.UNBOUNDED)]
    apart = falling._replace(rows=np.stack([rows[0], -rows[0]]), bounds=np.array([-1.0, -1.0]))
    cases.append((apart, MethodStatus.INFEASIBLE))
    twice = falling._replace(equal=np.stack([equal[0], equal[0]]), right=np.array([0.0, 1.0]))
    cases.append((twice, MethodStatus.INFEASIBLE))
    fixed = LinearProgram(rng.normal(size=5), np.eye(5), inside, rows, rows @ inside - 1)
    cases.append((fixed, MethodStatus.INFEASIBLE))
    cases.append((fixed._replace(bounds=rows @ inside + 1), MethodStatus.SOLVED))
    boxed = falling._replace(rows=np.concatenate([np.eye(5), -np.eye(5)]), bounds=np.full(10, 10.0))
    cases.append((boxed, MethodStatus.SOLVED))
    repeated = boxed._replace(equal=np.stack([equal[0], 2 * equal[0]]), right=equal[0] @ inside * np.array([1, 2]))
    cases.append((repeated, MethodStatus.SOLVED))
    for program, status in cases:
        plain, compact = solve_plain(program), solve_compact_dual(program)
        assert plain.status == compact.status == status
        if status == MethodStatus.SOLVED:
            assert compact.value == pytest.approx(plain.value, rel=1e-9)
            np.testing.assert_allclose(program.equal @ compact.x, program.right, atol=1e-9)
            assert (program.rows @ compact.x <= program.bounds + 1e-7).all()
            assert program.cost @ compact.x == pytest.approx(compact.value, rel=1e-9)


def test_the_compact_dual_has_few_rows():
    """3n - 6 free forces and the largest normal force; a column for each inequality."""
    for n in (3, 5, 10):
        problem = P.problems("ordinary", n, 1, seed=0)
        scaled_batch = read_input(grasp_of(problem), problem.wrench)
        scaled, loads = scale(scaled_batch)
        program = load_program(host_problem(scaled_batch, scaled, loads[0], 0), 1.0, 1.0, 8, "inscribed")
        plain, dual = sizes_of(program)
        assert plain[:2] == (6 + 10 * n, 3 * n + 1) and dual[:2] == (3 * n - 5, 10 * n)


@pytest.mark.parametrize(
    "options, message",
    [({"sides": 2}, "sides is 2"), ({"pyramid": "round"}, "pyramid is 'round'"), ({"energy": -1.0}, "energy is -1.0")]
    + [({"energy": 0.0, "balance": 0.0}, "both 0"), ({"balance": float("nan")}, "balance is nan")],
)
def test_bad_arguments_raise(problem, options, message, unchecked):
    for method in (orin_oh, cheng_orin):
        with pytest.raises(ValueError, match=message):
            method(grasp_of(problem), problem.wrench, **options)


@pytest.mark.parametrize(
    "limits, message",
    [
        ({"normal_min": np.full(N, 1.0)}, "have no upper bound"),
        ({"normal_max": np.full(N, -1.0)}, r"normal_max\[0\] is -1.0"),
        ({"normal_max": np.full(N, 1.0), "normal_min": np.full(N, 2.0)}, "no less than normal_min"),
        ({"normal_max": np.full(3, 1.0)}, r"normal_max has shape \(3,\)"),
        ({"torque_max": np.full(JOINTS, 1.0)}, "without torque_map"),
        ({"torque_max": -np.ones(JOINTS), "torque_map": np.zeros((N, 3, JOINTS))}, r"torque_max\[0\] is -1.0"),
        ({"torque_max": np.ones(JOINTS), "torque_map": np.zeros((N, 4, JOINTS))}, "torque_map has shape"),
    ],
)
def test_bad_limits_raise(problem, limits, message, unchecked):
    with pytest.raises((ValueError, GraspError), match=message):
        kerr_roth(grasp_of(problem), problem.wrench, limits=Limits(**limits))
