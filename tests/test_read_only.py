"""Host functions leave the arrays that they are given as they are: these are read-only while the functions run."""

import contextlib
import dataclasses
import functools
import importlib
import inspect
import pkgutil
from collections.abc import Iterator

import jax
import numpy as np
import pytest
import trimesh

import jaxgrasp.hand
import jaxgrasp.psychophysics.analysis
import jaxgrasp.quality
from jaxgrasp.hand import Mesh
from jaxgrasp.psychophysics.analysis.counts import Counts
from jaxgrasp.quality import ferrari_canny, force_closure, largest_wrench, min_weight
from tests.quality import known

WRITERS = {
    "jaxgrasp.quality.closure._decide_easy",
    "jaxgrasp.quality.largest_ball._bring_together",
    "jaxgrasp.quality.largest_wrench._by_simplex",
    "jaxgrasp.quality.largest_wrench._by_twist",
    "jaxgrasp.quality.min_weight._by_simplex",
    "jaxgrasp.quality.min_weight._to_optimum",
    "jaxgrasp.quality.refine_facet._move",
}
"""Functions whose purpose is to write into an argument; callers give them arrays that nothing else reads."""
MODULES = {
    f"{package.__name__}.{name}": importlib.import_module(f"{package.__name__}.{name}")
    for package in (jaxgrasp.quality, jaxgrasp.hand, jaxgrasp.psychophysics.analysis)
    for _, name, _ in pkgutil.iter_modules(package.__path__)
}


def arrays_in(value: object) -> Iterator[np.ndarray]:
    """Yield every NumPy array in nested tuples, lists, dictionaries and dataclasses."""
    if isinstance(value, np.ndarray):
        yield value
    elif isinstance(value, tuple | list):
        for part in value:
            yield from arrays_in(part)
    elif isinstance(value, dict):
        yield from arrays_in(list(value.values()))
    elif dataclasses.is_dataclass(value) and not isinstance(value, type):
        yield from arrays_in([getattr(value, field.name) for field in dataclasses.fields(value)])


def with_frozen_arguments(function):
    """Wrap the function so that writing to its argument arrays raises a ValueError."""

    @functools.wraps(function)
    def call(*args, **kwargs):
        frozen = [array for array in arrays_in((args, kwargs)) if array.flags.writeable]
        for array in frozen:
            array.flags.writeable = False
        try:
            return function(*args, **kwargs)
        finally:
            still_frozen.extend(frozen)
            thaw()

    return call


still_frozen: list[np.ndarray] = []
"""Arrays to make writeable again: a view cannot be while an outer call keeps its base frozen."""


def thaw() -> None:
    """Make arrays writeable, those that own their memory first."""
    for array in sorted(still_frozen, key=lambda array: array.base is not None):
        with contextlib.suppress(ValueError):
            array.flags.writeable = True
    still_frozen[:] = [array for array in still_frozen if not array.flags.writeable]


@pytest.fixture
def frozen(monkeypatch):
    """Wrap the functions of the modules above wherever these import them; return their names."""
    wrapped = {}
    for name, module in MODULES.items():
        for attribute, function in vars(module).items():
            is_host = inspect.isfunction(function) and function.__module__ == name
            if is_host and f"{name}.{attribute}" not in WRITERS:
                wrapped[function] = with_frozen_arguments(function)
    for module in MODULES.values():
        for attribute, function in list(vars(module).items()):
            if inspect.isfunction(function) and function in wrapped:
                monkeypatch.setattr(module, attribute, wrapped[function])
    return {f"{function.__module__}.{function.__name__}" for function in wrapped}


def function_of(name: str):
    """Return the wrapped function of a module, not the one that its package imported before."""
    module, _, attribute = name.rpartition(".")
    return getattr(MODULES[f"jaxgrasp.{module}"], attribute)


def read_only(tree):
    """Return read-only copies of the arrays of a grasp, or of nested tuples."""

    def freeze(array):
        copy = np.array(array)
        copy.flags.writeable = False
        return copy

    return jax.tree.map(freeze, tree)


@pytest.mark.parametrize("torsion", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_measures_of_quality_do_not_write_into_what_they_are_given(frozen, torsion):
    """Grasps that are closed, open, on the edge and flat, so that fall-backs are met as well."""
    assert {"jaxgrasp.quality.refine_facet._newton", "jaxgrasp.quality.closure.decide_all"} <= frozen
    plain = known.ordinary(4, 24, seed=7, torsion=torsion)
    rough = np.random.default_rng(1).uniform(-3, 3, plain.friction.shape)
    wide = known.changed(plain, friction=10**rough)
    star = known.star([0, 90, 180, 270], 1e-9, torsion=1e-3 if torsion else None)
    edge = jax.tree.map(lambda array: array[None], star)
    task = read_only(np.ones((len(plain.friction), 6)))
    for grasp in map(read_only, (plain, wide, edge)):
        function_of("quality.closure.force_closure")(grasp)
        function_of("quality.min_weight.min_weight")(grasp)
        for bound in ("l1", "linf"):
            function_of("quality.ferrari_canny.ferrari_canny")(grasp, bound)
            function_of("quality.largest_wrench.largest_wrench")(grasp, task[: len(grasp.friction)], bound)
        function_of("quality.ferrari_canny.ferrari_canny")(grasp, "linf", sides=4)


def test_solids_do_not_write_into_their_meshes(frozen):
    box = trimesh.creation.box((0.06, 0.09, 0.05))
    mesh = Mesh(*read_only((np.asarray(box.vertices), np.asarray(box.faces))))
    assert {"jaxgrasp.hand.filling._without_empty", "jaxgrasp.hand.filling.sphere_tree"} <= frozen
    function_of("hand.filling.sphere_tree")(function_of("hand.mesh.check_mesh")(mesh), 3)
    function_of("hand.filling.level_errors")(mesh, 2, samples=100)
    function_of("hand.mesh.principal_frame")(mesh)


def test_analyses_of_experiments_do_not_write_into_their_counts(frozen):
    levels, hits, trials = read_only((np.array([1.0, 2, 4, 8]), np.array([11, 13, 16, 20]), np.array([20, 20, 20, 20])))
    counts = Counts(levels, hits, trials)
    for method in ("likelihood", "posterior", "interpolation", "line", "paper"):
        function_of("psychophysics.analysis.threshold.threshold")(counts, method=method)
    table = read_only(np.random.default_rng(0).normal(size=(6, 3)))
    function_of("psychophysics.analysis.anova.repeated_measures")(table)
    function_of("psychophysics.analysis.anova.compare_conditions")(table)
    function_of("psychophysics.analysis.anova.compare_groups")(list(table))
    assert "jaxgrasp.psychophysics.analysis.threshold.line_estimates" in frozen


def test_results_of_one_call_share_no_memory():
    """A caller may write into one array of a result; no other changes, nor does a second call's."""
    grasp = known.ordinary(4, 6, seed=7)
    for measure in (ferrari_canny, force_closure, min_weight, lambda g: largest_wrench(g, np.ones((6, 6)))):
        first, second = measure(grasp), measure(grasp)
        leaves = [np.asarray(leaf) for solution in (first, second) for leaf in solution]
        inputs = list(arrays_in([getattr(grasp, name) for name in ("points", "normals", "friction", "squeeze")]))
        for index, leaf in enumerate(leaves):
            assert not any(np.shares_memory(leaf, other_leaf) for other_leaf in (*leaves[:index], *inputs))
