"""The kernel behind the public functions: plain calls, jit, vmap, derivatives, several devices, and its switch."""

import os
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.sharding import AxisType, PartitionSpec

import jaxgrasp
from jaxgrasp import Limits, Verdict
from jaxgrasp import kernel as package
from jaxgrasp.kernel import compiled, gpu
from jaxgrasp.solver import in_kernel, phases, programs
from jaxgrasp.solver.in_kernel import Wanted
from jaxgrasp.testing.problems import problems
from tests.kernel.conftest import problem_of, solve_batch
from tests.kernel.test_against_jax import COUNT, N, grasp_of

pytest.importorskip("warp")
BOTH, OPTIMUM = Wanted(closed_form=True, optimum=True), Wanted(closed_form=False, optimum=True)
# Rounding of sums in another order.
ROUNDING = {np.dtype(np.float64): 1e-9, np.dtype(np.float32): 2e-4}


def flat_problem(kind: str, dtype=np.float64, **fields):
    problem = problems(kind, N, COUNT, seed=31)
    arrays = {name: getattr(problem, name) for name in ("points", "normals", "friction", "squeeze", "wrench")}
    return problem_of({name: np.asarray(array, dtype) for name, array in (arrays | fields).items()})


def check_same(result, expected, tolerance: float) -> None:
    """Check that two results have the same verdicts and, within a share of the largest force, the same numbers."""
    assert np.array_equal(result.verdict, expected.verdict)
    assert np.array_equal(result.route, expected.route) and np.array_equal(result.rank, expected.rank)
    assert np.array_equal(result.undecided, np.asarray(expected.verdict) == Verdict.NOT_CONVERGED)
    # What the search for forces that do not exist came to, and its proof, hang on the last digits.
    held = ~np.isin(expected.verdict, (Verdict.NOT_CONVERGED, Verdict.INFEASIBLE))
    for name in ("forces", "multiplier", "objective", "certificate", "force_bound", "moments", "normal_multiplier"):
        value, other = getattr(result, name), getattr(expected, name)
        assert (value is None) == (other is None), name
        if other is not None:
            value, other = np.asarray(value)[held], np.asarray(other)[held]
            axes = tuple(range(1, other.ndim))
            scale = np.maximum(np.abs(other).max(axes, initial=0), 1e-30)
            assert np.all(np.abs(value - other).max(axes, initial=0) <= tolerance * scale), name
    infeasible = np.asarray(expected.verdict) == Verdict.INFEASIBLE
    assert np.all((np.asarray(result.force_bound) > 0) == infeasible)


def closed_form_forces(grasp, wrench):
    return jaxgrasp.closed_form(grasp, wrench).forces


@pytest.fixture(scope="module")
def by_phases():
    return jax.jit(phases.solve_both)


FIELDS = {
    "hard": {},
    "soft": {"torsion": np.linspace(0, 0.02, N) * np.ones((COUNT, N))},
    "bounded": {"normal_min": np.full((COUNT, N), 0.2), "normal_max": np.full((COUNT, N), 6.0)},
    "absent": {"present": np.ones((COUNT, N)) - np.eye(N)[np.arange(COUNT) % N]},
}


@pytest.mark.parametrize(
    ("fields", "dtype"), [(name, np.float64) for name in FIELDS] + [("hard", np.float32)], ids=lambda x: str(x)
)
def test_results_are_those_of_the_phases(by_phases, fields, dtype):
    extra = {name: np.asarray(array, dtype) for name, array in FIELDS[fields].items()}
    problem = flat_problem("ordinary", dtype, **extra)
    results, expected = solve_batch(problem, BOTH), by_phases(jax.tree.map(jnp.asarray, problem))
    for result, other in zip(results, expected, strict=True):
        check_same(result, other, ROUNDING[np.dtype(dtype)])


def test_a_start_leads_to_the_same_optimum_in_fewer_steps():
    problem = flat_problem("ordinary")
    (cold,) = solve_batch(problem, OPTIMUM)
    (warm,) = solve_batch(flat_problem("ordinary", start=cold.multiplier), OPTIMUM)
    assert np.array_equal(cold.verdict, warm.verdict)
    assert np.allclose(warm.forces, cold.forces, atol=1e-9 * np.abs(cold.forces).max())
    outside = cold.verdict == Verdict.OPTIMAL
    assert outside.sum() > 10 and warm.steps[outside].sum() < 0.5 * cold.steps[outside].sum()
    (lost,) = solve_batch(flat_problem("ordinary", start=np.full_like(cold.multiplier, np.nan)), OPTIMUM)
    assert np.array_equal(lost.forces, cold.forces)


def test_many_wrenches_share_a_grasp():
    problem = flat_problem("ordinary")
    first = {name: getattr(problem, name)[:1] for name in ("points", "normals", "friction", "squeeze")}
    (shared,) = solve_batch(problem_of(first | {"wrench": problem.wrench}), OPTIMUM)
    repeated = {name: np.repeat(array, COUNT, 0) for name, array in first.items()}
    (expected,) = solve_batch(problem_of(repeated | {"wrench": problem.wrench}), OPTIMUM)
    assert np.array_equal(shared.forces, expected.forces) and np.array_equal(shared.verdict, expected.verdict)


@pytest.mark.parametrize("size", [1, 7, COUNT])
def test_plain_jitted_and_mapped_calls_agree(used_kernel, size):
    problem = problems("ordinary", N, COUNT, seed=31)
    grasp, wrench = jax.tree.map(lambda x: x[:size], grasp_of(problem)), problem.wrench[:size]
    plain = jaxgrasp.constrained_optimum(grasp, wrench)
    assert np.all(plain.verdict <= Verdict.OPTIMAL)
    jitted = jax.jit(jaxgrasp.constrained_optimum)(grasp, wrench)
    mapped = jax.vmap(jaxgrasp.constrained_optimum)(grasp, wrench)
    closed, both = jaxgrasp.closed_form_and_optimum(grasp, wrench)
    assert np.array_equal(closed.forces, jaxgrasp.closed_form(grasp, wrench).forces)
    for other in (jitted, mapped, both):
        assert np.array_equal(plain.forces, other.forces) and np.array_equal(plain.verdict, other.verdict)


def test_a_new_batch_size_compiles_no_phase(used_kernel, monkeypatch):
    def refuse(*_):
        raise AssertionError("the phases are traced")

    for name in ("solve_optimum", "solve_closed", "run_phases"):
        monkeypatch.setattr(phases, name, refuse)
    problem = problems("ordinary", N, COUNT, seed=31)
    for size in (3, 11):
        grasp = jax.tree.map(lambda x, size=size: x[:size], grasp_of(problem))
        assert np.all(jaxgrasp.constrained_optimum(grasp, problem.wrench[:size]).verdict <= Verdict.OPTIMAL)


@pytest.mark.parametrize("solve", [jaxgrasp.closed_form, jaxgrasp.constrained_optimum])
def test_a_size_that_comes_again_is_not_padded_and_has_the_same_answers(used_kernel, monkeypatch, solve):
    """The first call of 23 problems is padded, the second has a program of its own: to the last bit the same."""
    problem = problems("ordinary", N, COUNT, seed=31)
    grasp, wrench = jax.tree.map(lambda x: x[:23], grasp_of(problem)), problem.wrench[:23]
    padded_calls, chunks = [], programs.chunks
    monkeypatch.setattr(programs, "chunks", lambda *sizes: padded_calls.append(sizes) or chunks(*sizes))
    programs._recent_sizes().clear()
    padded, again, jitted = solve(grasp, wrench), solve(grasp, wrench), jax.jit(solve)(grasp, wrench)
    assert len(padded_calls) == 1
    for answer in (again, jitted):
        jax.tree.map(np.testing.assert_array_equal, padded, answer)


def test_derivatives_are_those_of_the_jax_solver(used_kernel, monkeypatch):
    problem = problems("ordinary", N, 3, seed=31)

    def cost(wrench, friction):
        grasp = jaxgrasp.Grasp(problem.points, problem.normals, friction, problem.squeeze)
        return jnp.sum(jaxgrasp.constrained_optimum(grasp, wrench).forces ** 2)

    gradient = jax.grad(cost, (0, 1))(problem.wrench, problem.friction)
    monkeypatch.setattr(package, "_choice", False)
    expected = jax.grad(lambda *x: cost(*x), (0, 1))(problem.wrench, problem.friction)
    for one, other in zip(gradient, expected, strict=True):
        assert np.allclose(one, other, rtol=1e-8, atol=1e-8 * np.abs(other).max())


def test_arrays_of_a_device_do_not_pass_through_the_host(used_kernel):
    problem = problems("ordinary", N, 3, seed=31)
    arrays = jax.device_put((grasp_of(problem), problem.wrench))

    def cost(grasp, wrench):
        return jnp.sum(jaxgrasp.constrained_optimum(grasp, wrench).forces ** 2)

    gradient = jax.jit(jax.value_and_grad(cost, (0, 1), allow_int=True))
    with jax.transfer_guard("disallow"):
        value, _ = gradient(*arrays)
    assert value > 0
    assert "callback" not in gradient.lower(*arrays).as_text()


@pytest.mark.slow
def test_problems_that_the_kernel_does_not_know_go_to_the_phases(used_kernel):
    problem = problems("ordinary", N, 3, seed=31)
    grasp = grasp_of(problem)
    limits = Limits(torque_map=np.ones((3, N, 3, 2)), torque_max=np.full((3, 2), 1e3))
    limited = jaxgrasp.constrained_optimum(grasp, problem.wrench, limits=limits)
    assert limited.torque_multiplier is not None
    assert np.allclose(limited.forces, jaxgrasp.constrained_optimum(grasp, problem.wrench).forces, atol=1e-7)
    guided = jaxgrasp.closed_form(grasp, problem.wrench, free=np.eye(6)[:, :2])
    assert np.all(np.asarray(guided.rank) == 2)
    crowd = problems("ordinary", compiled.ROOMS[-1] + 1, 2, seed=31)
    arrays = {name: getattr(crowd, name) for name in ("points", "normals", "friction", "squeeze", "wrench")}
    assert not in_kernel.supports(problem_of(arrays))


def test_bad_data_are_invalid(used_kernel):
    problem = problems("ordinary", N, 3, seed=31)
    problem.points[1, 0, 0] = np.nan
    verdict = jaxgrasp.constrained_optimum(grasp_of(problem), problem.wrench).verdict
    assert [int(code) == Verdict.INVALID_DATA for code in verdict] == [False, True, False]


def test_use_kernel_names_the_missing_extra(monkeypatch):
    monkeypatch.setattr(package, "_choice", None)
    monkeypatch.setattr(package, "is_installed", lambda: False)
    with pytest.raises(ImportError, match=r"pip install 'jaxgrasp\[kernel\]'"):
        package.use_kernel()
    assert not package.is_used()
    package.use_kernel(False)
    assert not package.is_used()


@pytest.mark.parametrize(("value", "used"), [("0", False), ("1", True)])
def test_the_environment_variable_switches_the_kernel_off(monkeypatch, value, used):
    monkeypatch.setattr(package, "_choice", None)
    monkeypatch.setenv(package.VARIABLE, value)
    assert package.is_used() is used


def test_lines_of_c_code_are_kept_but_for_the_known_one(capfd):
    with compiled._without_line(b"known"):
        os.write(2, b"known line\nanother line\n")
    assert capfd.readouterr().err == "another line\n"


def test_the_kernel_compiles_without_the_whole_header_of_warp_and_with_it_where_need_be(monkeypatch, tmp_path, capfd):
    variant = compiled.Variant("float64", 8, False, False)
    assert all(compiled._published(variant, compiled.SOLVERS, with_whole_header=False))
    (tmp_path / "builtin.h").write_text("#error This header of another version lacks something.\n")
    monkeypatch.setattr(compiled, "WARP_HEADERS", tmp_path)
    assert compiled._published(variant, compiled.SOLVERS, with_whole_header=False) == ()
    assert len(compiled.addresses.__wrapped__(variant)) == 2
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize("platforms", [["cpu"], ["cuda"]])
def test_exported_programs_have_the_jax_solver(used_kernel, platforms):
    problem = problems("ordinary", N, 3, seed=31)
    solve = jax.jit(
        lambda points, normals, friction, squeeze, wrench: closed_form_forces(
            jaxgrasp.Grasp(points, normals, friction, squeeze), wrench
        )
    )
    arrays = (problem.points, problem.normals, problem.friction, problem.squeeze, problem.wrench)
    # A program that the kernel was lowered for first must not be exported.
    expected = solve(*arrays)
    exported = jax.export.export(solve, platforms=platforms)(*arrays)
    assert "jaxgrasp_float64" not in exported.mlir_module()
    assert "jaxgrasp_float64" in solve.lower(*arrays).as_text()
    gradient = jax.jit(jax.grad(lambda wrench: solve(*arrays[:4], wrench).sum()))
    assert "jaxgrasp_float64" not in jax.export.export(gradient, platforms=platforms)(problem.wrench).mlir_module()
    if platforms == ["cpu"]:
        pytest.importorskip("flatbuffers")
        again = jax.export.deserialize(exported.serialize()).call(*arrays)
        assert np.allclose(again, expected, rtol=0, atol=1e-9 * np.abs(expected).max())


DEVICES = """
import jax
jax.config.update("jax_enable_x64", True)
import numpy as np
import jaxgrasp
from jax.sharding import AxisType, NamedSharding, PartitionSpec
from jaxgrasp.testing.problems import problems
problem = problems("ordinary", 4, 60, seed=31)
grasp = jaxgrasp.Grasp(problem.points, problem.normals, problem.friction, problem.squeeze)
expected = jaxgrasp.constrained_optimum(grasp, problem.wrench)
solve = jax.jit(jaxgrasp.constrained_optimum)
def check(solution):
    assert np.array_equal(solution.forces, expected.forces) and np.array_equal(solution.verdict, expected.verdict)
check(jaxgrasp.constrained_optimum(grasp, problem.wrench, devices=2))
for kind in (AxisType.Auto, AxisType.Explicit):
    mesh = jax.make_mesh((2,), ("batch",), axis_types=(kind,))
    spread = lambda x: jax.device_put(x, NamedSharding(mesh, PartitionSpec("batch")))
    arguments = jax.tree.map(spread, (grasp, problem.wrench))
    solution = jaxgrasp.constrained_optimum(*arguments)
    check(solution)
    assert solution.forces.sharding.spec[0] == "batch"
    if kind == AxisType.Auto:
        assert "all-gather" not in solve.lower(*arguments).compile().as_text()
"""


def test_each_device_solves_its_own_part():
    environment = {
        "XLA_FLAGS": "--xla_force_host_platform_device_count=2",
        package.VARIABLE: "1",
        "JAX_PLATFORMS": "cpu",
    }
    result = subprocess.run(
        [sys.executable, "-c", DEVICES], capture_output=True, text=True, env=os.environ | environment
    )
    assert result.returncode == 0, result.stderr
    assert result.stderr == ""


@pytest.mark.slow
@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_the_kernel_of_a_gpu_gives_the_same_answers(dtype):
    problem = flat_problem("ordinary", dtype)
    expected = solve_batch(problem, BOTH)
    results = jax.jit(lambda p: in_kernel._on_gpu(p, BOTH))(problem)
    for result, other in zip(results, expected, strict=True):
        check_same(result, other, ROUNDING[np.dtype(dtype)])


@pytest.mark.slow
def test_nvrtc_compiles_the_headers_without_a_gpu(tmp_path):
    warp = compiled.initialised_warp()
    kernel = gpu.gpu_kernel(compiled.Variant("float32", 4, True, True))
    warp.compile_aot_module(kernel.module, arch=90, module_dir=str(tmp_path), use_ptx=True)
    assert list(tmp_path.glob("*.ptx"))


def test_derivatives_inside_shard_map(used_kernel):
    problem = problems("ordinary", N, 6, seed=31)
    arrays = jax.tree.map(jnp.asarray, (grasp_of(problem), problem.wrench))
    mesh, axes = jax.make_mesh((1,), ("batch",), axis_types=(AxisType.Auto,)), PartitionSpec("batch")

    def gradient(grasp, wrench):
        return jax.grad(lambda w: jnp.sum(jaxgrasp.constrained_optimum(grasp, w).forces))(wrench)

    spread = jax.shard_map(gradient, mesh=mesh, in_specs=axes, out_specs=axes)
    assert jax.eval_shape(spread, *arrays).shape == (6, 6)
