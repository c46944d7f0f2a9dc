"""Laws of the C++ kernel's answers, without the JAX solver; and that its header says what the Python code says."""

import re

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from benchmarks.kernel_calls import ARRAYS, Kernel, arrays_of, compile_files
from jaxgrasp import Route, Verdict
from jaxgrasp.kernel import include_folder
from jaxgrasp.kernel.tolerances_header import HEADER, header_text
from jaxgrasp.solver import infeasibility, newton, optimality, phases, proximal, refinement
from jaxgrasp.testing.problems import problems

SIZES = (3, 5, 9, 20)


def _optimal(kernel, n: int):
    problem = problems("ordinary", n, 200, seed=21)
    answers = kernel.solve(**arrays_of(problem))
    assert np.all(answers.verdict <= Verdict.OPTIMAL)
    return problem, answers


def test_tolerances_are_those_of_python():
    assert HEADER.read_text() == header_text()


def test_codes_are_those_of_python():
    text = (include_folder() / "one_grasp.h").read_text()
    for enum in (Verdict, Route):
        (body,) = re.findall(rf"enum {enum.__name__} : int {{(.*?)}};", text, re.DOTALL)
        codes = {name: int(code) for name, code in re.findall(r"(\w+) = (\d+)", body)}
        assert codes.items() <= {member.name: int(member) for member in enum}.items() and len(codes) >= 3


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("ARMIJO", newton.ARMIJO),
        ("SHORTEST_STEP", newton.SHORTEST_STEP),
        ("DAMPING", newton.DAMPING),
        ("LARGEST_DAMPING", newton.LARGEST_DAMPING),
        ("FIRST_STRENGTH", proximal.FIRST_STRENGTH),
        ("NEAR_STRENGTH", proximal.NEAR_STRENGTH),
        ("STEPS_PER_STAGE", proximal.STEPS_PER_STAGE),
        ("LONG_STEPS_PER_STAGE", phases.PHASES[-1].steps),
        ("LONG_MIN_PROXIMAL_WEIGHT", phases.PHASES[-1].min_proximal_weight),
        ("LOOSE_FACTOR", optimality.LOOSE_FACTOR),
        ("BEYOND", infeasibility.BEYOND),
        ("VERIFIER_ROUNDING", infeasibility.VERIFIER_ROUNDING),
        ("TURNS", infeasibility.TURNS),
        ("ENOUGH", refinement.ENOUGH),
        ("REFINING_STEPS", refinement.REFINING_STEPS),
        ("CORRECTIONS", refinement.CORRECTIONS),
        ("LEAST_DAMPING", refinement.LEAST_DAMPING),
    ],
)
def test_constants_are_those_of_the_jax_solver(name, value):
    text = (include_folder() / "one_grasp.h").read_text()
    (number,) = re.findall(rf"\b{name} = (?:Real\()?([-\d.e]+)", text)
    assert float(number) == value


@pytest.mark.parametrize("n", SIZES)
def test_forces_balance_the_wrench_inside_the_cones(kernel, n):
    problem, answers = _optimal(kernel, n)
    forces = answers.forces
    wrench = np.concatenate([forces.sum(1), np.cross(problem.points, forces).sum(1)], -1)
    size = np.abs(forces).sum((1, 2))[:, None]
    assert np.all(np.abs(wrench - problem.wrench) <= 1e-9 * size)
    along = np.sum(forces * problem.normals, -1)
    across = np.linalg.norm(forces - along[..., None] * problem.normals, axis=-1)
    assert np.all(across <= problem.friction * along + 1e-12 * size)


@pytest.mark.parametrize("n", SIZES)
def test_no_allowed_forces_of_the_same_wrench_cost_less(kernel, n):
    problem, answers = _optimal(kernel, n)

    def cost(forces: np.ndarray) -> np.ndarray:
        deviation = forces - problem.squeeze[..., None] * problem.normals
        return np.sum(np.sum(deviation**2, -1) / (2 * problem.squeeze), -1)

    objective = answers.answer["objective"]
    assert np.allclose(objective, cost(answers.forces), rtol=1e-10)
    assert np.all(objective <= cost(problem.witness) * (1 + 1e-10))


@pytest.mark.parametrize("n", SIZES)
def test_the_order_of_the_contacts_does_not_matter(kernel, n):
    problem, answers = _optimal(kernel, n)
    order = np.random.default_rng(0).permutation(n)
    arrays = {name: x if name == "wrench" else x[:, order] for name, x in arrays_of(problem).items()}
    again = kernel.solve(**arrays)
    assert np.array_equal(again.verdict, answers.verdict)
    assert np.allclose(again.forces, answers.forces[:, order], rtol=0, atol=1e-10 * np.abs(answers.forces).max())


@pytest.mark.parametrize("n", SIZES)
def test_absent_contacts_change_nothing(kernel, n):
    problem, answers = _optimal(kernel, n)
    arrays = {
        name: x if name == "wrench" else np.concatenate([x[:, :1] + np.nan, x], 1)
        for name, x in arrays_of(problem).items()
    }
    again = kernel.solve(**arrays, present=np.repeat([[0.0] + [1.0] * n], len(problem.wrench), 0))
    assert np.array_equal(again.verdict, answers.verdict) and not again.forces[:, 0].any()
    assert np.allclose(again.forces[:, 1:], answers.forces, rtol=0, atol=1e-10 * np.abs(answers.forces).max())


@pytest.mark.parametrize("n", [3, 4])
def test_absent_contacts_weaken_no_proof(kernel, n):
    """Their points lie anywhere, here ten metres off, and so do those of lanes without a contact."""
    rng = np.random.default_rng(1)
    outward = rng.normal(size=(50, 4, 3))
    outward[..., 2] = np.abs(outward[..., 2])
    far = np.full(3, 10.0)
    points = 0.05 * outward / np.linalg.norm(outward, axis=-1, keepdims=True) + far
    force = np.tile([0, 0, 3.0], (50, 1))
    arrays = {
        "points": points[:, :n],
        "normals": -outward[:, :n],
        "friction": np.zeros((50, n)),
        "squeeze": np.ones((50, n)),
        "wrench": np.concatenate([force, np.cross(far, force)], -1),
    }
    answer = kernel.solve(**arrays, present=np.tile([1.0, 1, 1, 0][:n], (50, 1))).answer
    assert np.all(answer["verdict"] == Verdict.INFEASIBLE)
    # w.d / (8 roundings) with the rounding 4 eps |d| (1 + distance / length), the length by the three present contacts.
    spread = points[:, :3] - points[:, :3].mean(1, keepdims=True)
    length = np.sqrt(np.sum(spread**2, (1, 2)) / 3)
    linear, angular = answer["certificate"][:, :3], answer["certificate"][:, 3:]
    about_centre = linear + np.cross(angular, points[:, :3].mean(1))
    size = np.hypot(np.linalg.norm(about_centre, axis=-1), length * np.linalg.norm(angular, axis=-1))
    rounding = 4 * np.finfo(float).eps * size * (1 + np.linalg.norm(points[:, :3].mean(1), axis=-1) / length)
    work = np.sum(answer["certificate"] * arrays["wrench"], -1)
    # Along some certificates a contact pushes a little, and then they prove less.
    assert np.median(answer["force_bound"] * 8 * rounding / work) == pytest.approx(1, rel=1e-3)


@pytest.mark.parametrize("n", SIZES)
def test_forces_turn_and_scale_with_the_problem(kernel, n):
    problem, answers = _optimal(kernel, n)
    turn, shift, length, force = Rotation.random(random_state=1).as_matrix(), np.array([0.3, -2.0, 1.0]), 1e3, 1e-4
    points = length * (problem.points @ turn.T + shift)
    linear = force * problem.wrench[:, :3] @ turn.T
    torque = force * length * problem.wrench[:, 3:] @ turn.T + np.cross(length * shift, linear)
    again = kernel.solve(
        points=points,
        normals=2 * problem.normals @ turn.T,  # of any length
        friction=problem.friction,
        squeeze=force * problem.squeeze,
        wrench=np.concatenate([linear, torque], -1),
    )
    assert np.array_equal(again.verdict, answers.verdict)
    expected = force * answers.forces @ turn.T
    assert np.allclose(again.forces, expected, rtol=0, atol=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize("name", ARRAYS)
@pytest.mark.parametrize("number", [np.nan, np.inf, -np.inf, -1.0])
def test_data_that_cannot_be_used_are_invalid(kernel, name, number):
    problem = problems("ordinary", 5, 3, seed=22)
    arrays = arrays_of(problem)
    arrays |= {
        "weights": problem.squeeze,
        "present": np.ones_like(problem.squeeze),
        "torsion": 0 * problem.squeeze + 0.001,
        "normal_min": 0 * problem.squeeze,
        "normal_max": 0 * problem.squeeze + np.inf,
    }
    arrays[name] = arrays[name].copy()
    arrays[name][1].flat[0] = number
    signed = ("points", "normals", "wrench", "present")
    allowed = (number == -1 and name in signed) or (number == np.inf and name in ("normal_max", "present"))
    allowed = allowed or (name == "present" and number == -np.inf)
    verdict = kernel.solve(**arrays).verdict
    assert (verdict[1] == Verdict.INVALID_DATA) != allowed
    assert np.all(verdict[[0, 2]] <= Verdict.OPTIMAL)


def test_more_contacts_than_there_is_room_for_are_refused(compiled_by_gcc):
    problem = problems("ordinary", 65, 2, seed=23)
    answers = compiled_by_gcc.solve(**arrays_of(problem))
    assert np.all(answers.verdict == Verdict.INVALID_DATA) and not answers.forces.any()
    room = {name: x if name == "wrench" else x[:, :64] for name, x in arrays_of(problem).items()}
    assert np.all(compiled_by_gcc.solve(**room).verdict != Verdict.INVALID_DATA)


def test_overflowing_products_are_no_answer(kernel):
    points = 1e119 * np.array([[[1.1, 0.8, -0.2], [-0.1, 1.0, 0.3]]])
    normals = np.array([[[0.0, 0, -1], [0, 1, 0]]])
    answers = kernel.solve(
        points=points,
        normals=normals,
        friction=np.array([[0.5, 0.5]]),
        squeeze=np.array([[1.0, 2.0]]),
        wrench=np.array([[0, 1e123, -2, 1, 0, -1]]),
    )
    assert answers.verdict[0] == Verdict.INVALID_DATA


def test_an_extreme_spin_radius_hides_no_torque(kernel):
    problem = problems("ordinary", 5, 100, seed=24)
    torsion = np.where(np.arange(5) == 2, 1e120, 0.005) + 0 * problem.friction
    answers = kernel.solve(**arrays_of(problem), torsion=torsion)
    torque = np.cross(problem.points, answers.forces).sum(1) + np.sum(answers.moments[..., None] * problem.normals, 1)
    missed = np.linalg.norm(torque - problem.wrench[:, 3:], axis=-1)
    size = np.abs(answers.forces).sum((1, 2)) + np.abs(answers.moments).sum(-1)
    assert not np.any((missed > 1e-4 * size) & (answers.verdict <= Verdict.OPTIMAL))


def test_one_contact_at_a_time_gives_the_same(compiled_by_gcc, kernel, tmp_path):
    """Compilers without vector types take this path."""
    plain = Kernel(tmp_path, ("-O0", "-DJAXGRASP_LANES=1"))
    problem, answers = _optimal(kernel, 5)
    again = plain.solve(**arrays_of(problem))
    assert np.array_equal(again.verdict, answers.verdict)
    assert np.allclose(again.forces, answers.forces, rtol=0, atol=1e-10 * np.abs(answers.forces).max())


def test_fast_math_is_refused(compiled_by_gcc, tmp_path):
    source = tmp_path / "fast.cpp"
    source.write_text('#include "one_grasp.h"\n')
    with pytest.raises(RuntimeError, match="without -ffast-math"):
        compile_files([source], tmp_path / "fast.o", ["-c", "-ffast-math"])
