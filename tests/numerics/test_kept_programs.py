"""Programs that the next process reads: the same answers, and never those of other code, shapes or settings."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxgrasp
from jaxgrasp.model.solution import Solution
from jaxgrasp.numerics import kept_programs
from jaxgrasp.numerics.compiled_code import program_folder, use_cache
from jaxgrasp.numerics.kept_programs import SUFFIX, Program, clear_programs, key_of
from jaxgrasp.solver import phases, programs, transforms
from jaxgrasp.testing.problems import problems

KEY = "a function of the tests"


class Traced:
    """A function that counts how often it is traced."""

    def __init__(self) -> None:
        self.times = 0

    def __call__(self, arrays: dict[str, jax.Array], factor: jax.Array | None) -> dict[str, jax.Array]:
        self.times += 1
        return {"root": jnp.sqrt(arrays["x"]) * (2 if factor is None else factor), "same": arrays["x"]}


@pytest.fixture(autouse=True)
def trace_anew():
    """Let programs be read, which other tests do not."""


@pytest.fixture
def folder(tmp_path):
    return use_cache(tmp_path)


def _call(function, *arguments, key=KEY):
    """Return what a process that was never here before gets."""
    return Program(function, key)(*arguments)


def test_the_next_process_traces_nothing(folder):
    function, x = Traced(), np.array([4.0, -1.0, 2.0])
    first = _call(function, {"x": x}, None)
    again = _call(function, {"x": x}, None)
    assert function.times == 1
    assert np.array_equal(first["root"], [4, np.nan, 2 * np.sqrt(2)], equal_nan=True)
    assert all(np.array_equal(first[name], again[name], equal_nan=True) for name in first)
    assert [path.suffix for path in folder.iterdir() if path.is_file() and path.suffix == SUFFIX] == [SUFFIX]


def test_other_arguments_settings_keys_and_code_are_other_programs(folder, monkeypatch):
    function, x = Traced(), np.array([4.0, 1.0])
    calls = [
        lambda: _call(function, {"x": x}, None),
        lambda: _call(function, {"x": x[:1]}, None),
        lambda: _call(function, {"x": x.astype(np.float32)}, None),
        lambda: _call(function, {"x": x}, 3.0),
        lambda: _call(function, {"x": x}, np.float64(3)),
        lambda: _call(function, {"x": x}, None, key="another function"),
    ]
    for call in calls * 2:
        call()
    assert function.times == len(calls)
    with jax.default_matmul_precision("highest"):
        calls[0]()
    assert function.times == len(calls) + 1
    monkeypatch.setattr(kept_programs, "_environment", lambda: "another version")
    calls[0]()
    assert function.times == len(calls) + 2


@pytest.mark.parametrize("content", [b"", b"no program", "half"])
def test_a_file_that_is_no_program_is_replaced(folder, content):
    function, x = Traced(), np.array([4.0])
    _call(function, {"x": x}, None)
    (path,) = folder.glob(f"*{SUFFIX}")
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2] if content == "half" else content)
    assert _call(function, {"x": x}, None)["root"] == 4
    assert _call(function, {"x": x}, None)["root"] == 4
    assert function.times == 2 and len(list(folder.iterdir())) >= 1


def test_what_jax_read_from_its_own_cache_is_not_written_again(folder):
    function, x = Traced(), np.array([4.0])
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    for _ in range(3):
        assert _call(function, {"x": x}, None)["root"] == 4
        # The program of a version whose code traces to the same.
        for path in folder.glob(f"*{SUFFIX}"):
            path.unlink()
        jax.clear_caches()
    assert function.times == 3
    assert _call(function, {"x": x}, None)["root"] == 4
    assert not list(folder.glob(f"*{SUFFIX}"))


def test_a_folder_that_is_gone_costs_only_time(folder):
    function, x = Traced(), np.array([4.0])
    for path in folder.iterdir():
        path.unlink()
    folder.rmdir()
    assert _call(function, {"x": x}, None)["root"] == 4


def test_nothing_is_kept_where_nobody_asked(folder, tmp_path_factory):
    function, x = Traced(), np.array([4.0])
    with jax.debug_nans(True):
        _call(function, {"x": x}, None)
    _call(function, {"x": x}, None, key=None)
    jax.config.update("jax_compilation_cache_dir", str(tmp_path_factory.mktemp("of the user")))
    assert program_folder() is None
    _call(function, {"x": x}, None)
    assert not list(folder.glob(f"*{SUFFIX}"))


def test_keys_are_of_functions_of_modules():
    assert key_of(phases.run_phases, ("given", None)) == "jaxgrasp.solver.phases.run_phases ('given', None)"
    assert key_of(lambda x: x) is None and key_of(Traced()) is None and key_of(np.sqrt) is None
    assert key_of(jaxgrasp.closed_form) is None
    assert key_of(transforms.closed_form.by_phases) == "Solution of jaxgrasp.solver.phases.solve_closed"
    assert key_of(transforms.closed_form.by_kernel, None) is None


PROGRAMS = {"run_phases", "run_newton_phases", "_begin_optimum", "DifferentiableSolver"}


@pytest.fixture
def compiled_names():
    """Return the names of programs whose tracing or compiling JAX reports."""
    names = []

    def listen(event: str, duration: float, **details: str) -> None:
        if "jaxpr_trace" in event:
            names.append(details.get("fun_name"))

    jax.monitoring.register_event_duration_secs_listener(listen)
    yield names
    jax.monitoring.unregister_event_duration_listener(listen)


@pytest.mark.parametrize(
    "kind, call",
    [
        ("ordinary", jaxgrasp.closed_form),
        ("ordinary", jaxgrasp.constrained_optimum),
        ("infeasible", jaxgrasp.constrained_optimum),
    ],
)
def test_plain_calls_of_the_next_process_have_the_same_answers(folder, compiled_names, kind, call):
    drawn = problems(kind, 4, 10, seed=3)
    grasp = jaxgrasp.Grasp(drawn.points, drawn.normals, drawn.friction, drawn.squeeze)

    def of_a_new_process() -> Solution:
        clear_programs()
        programs._program.cache_clear()
        jax.clear_caches()
        compiled_names.clear()
        return call(grasp, drawn.wrench)

    first = of_a_new_process()
    assert PROGRAMS & set(compiled_names)
    again = of_a_new_process()
    assert not PROGRAMS & set(compiled_names)
    for one, other in zip(jax.tree.leaves(first), jax.tree.leaves(again), strict=True):
        assert np.array_equal(one, other, equal_nan=True)
