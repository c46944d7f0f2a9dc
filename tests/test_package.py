"""The house: lazy names, layers, array shapes checked, nothing global touched."""

import importlib
import pkgutil
import subprocess
import sys
from types import ModuleType

import jax
import jax.numpy as jnp
import jaxtyping
import pytest
from beartype.roar import BeartypeCallHintViolation

import jaxgrasp
from jaxgrasp.numerics import tiling


def in_a_new_process(code: str) -> None:
    subprocess.run([sys.executable, "-W", "error", "-c", code], check=True)


ROOMS = [jaxgrasp, *(getattr(jaxgrasp, name) for name in jaxgrasp._ROOMS)]


@pytest.mark.parametrize("room", ROOMS, ids=lambda room: room.__name__)
def test_a_room_shows_its_public_names_alone(room):
    assert dir(room) == sorted(room.__all__)
    modules = [name for name in room.__all__ if isinstance(getattr(room, name), ModuleType)]
    assert modules == (sorted(jaxgrasp._ROOMS) if room is jaxgrasp else [])
    with pytest.raises(AttributeError, match="no attribute 'nonsense'"):
        _ = room.nonsense


def test_no_name_has_two_homes():
    names = [name for room in ROOMS for name in room.__all__ if name not in jaxgrasp._ROOMS]
    assert len(names) == len(set(names))


def test_the_door_has_at_most_forty_names():
    assert len(jaxgrasp._HOME) <= 40


@pytest.mark.parametrize("room", ROOMS, ids=lambda room: room.__name__)
def test_public_names_are_documented(room):
    for name in room.__all__:
        public_object = getattr(room, name)
        assert public_object.__doc__ and len(public_object.__doc__) > 20, name


def test_importing_the_package_loads_nothing():
    in_a_new_process("import sys, jaxgrasp; assert not {'jax', 'numpy', 'mujoco', 'plotly'} & set(sys.modules)")


def test_gloves_and_psychophysics_need_no_jax():
    in_a_new_process("import sys, jaxgrasp.glove, jaxgrasp.psychophysics; assert 'jax' not in sys.modules")


def test_importing_everything_changes_no_global():
    names = [m.name for m in pkgutil.walk_packages(jaxgrasp.__path__, "jaxgrasp.") if not m.name.endswith(".machine")]
    in_a_new_process(
        # SciPy filters warnings of its own when it is imported: what is measured is ours.
        "import importlib, logging, warnings, jax, scipy.optimize\n"
        "before = (jax.config.values.copy(), logging.root.level, list(logging.root.handlers), list(warnings.filters))\n"
        f"[importlib.import_module(name) for name in {names!r}]\n"
        "after = (jax.config.values.copy(), logging.root.level, list(logging.root.handlers), list(warnings.filters))\n"
        "assert before == after\n"
        "import sys; assert not {'mujoco', 'plotly', 'matplotlib', 'clarabel'} & set(sys.modules)"
    )


def test_layers():
    run = subprocess.run([sys.executable, "-c", "from importlinter.cli import lint_imports; exit(lint_imports())"])
    assert run.returncode == 0


def test_array_shapes_are_checked_while_the_tests_run():
    with pytest.raises(jaxtyping.TypeCheckError):
        jaxgrasp.Grasp(jnp.zeros((3, 3)), jnp.zeros((3, 3)), jnp.zeros(4), jnp.zeros(3))
    with pytest.raises(jaxtyping.TypeCheckError):
        jaxgrasp.grasp_matrix(jnp.zeros((3, 2)))


def test_types_are_checked_while_the_tests_run_where_no_shape_is_said_too(monkeypatch):
    with pytest.raises(BeartypeCallHintViolation):
        tiling.width("1000", 8, 2)
    monkeypatch.setattr(jaxtyping.config, "jaxtyping_disable", True)
    assert tiling.width(1000.0, 8, 2) == 1000


def test_lost_precision_is_said():
    grasp = jax.tree.map(lambda x: x.astype("float64"), example())
    with jax.enable_x64(False), pytest.warns(UserWarning, match="float64 data are computed in float32"):
        jaxgrasp.closed_form(grasp, grasp.points[0].repeat(2))


@pytest.mark.slow
def test_a_warning_points_at_the_users_line():
    in_a_new_process(
        "import warnings, numpy as np, jaxgrasp\n"
        "g = jaxgrasp.Grasp(np.eye(3), -np.eye(3), np.ones(3), np.ones(3))\n"
        "w, calls = np.zeros(6), [jaxgrasp.closed_form, jaxgrasp.least_squeeze, jaxgrasp.reachable_wrench]\n"
        "calls += [lambda g, w: jaxgrasp.dual_value(g, w, w), lambda g, w: jaxgrasp.wrench_margin(g, w, w)]\n"
        "for call in calls:\n"
        "    with warnings.catch_warnings(record=True) as seen:\n"
        "        warnings.simplefilter('always')\n"
        "        call(g, w)\n"
        "    assert [one.filename for one in seen] == ['<string>'], [one.filename for one in seen]"
    )


def example():
    import numpy as np

    points = np.array([[1.0, 0, 0], [0, 1, 0], [0, 0, 1]])
    return jaxgrasp.Grasp(points, -points, np.ones(3), np.ones(3))


def test_modules_import_alone():
    # An import cycle shows only when one of its modules comes first.
    for name in ("jaxgrasp.problem.friction_cone", "jaxgrasp.batch.chunk_statistics", "jaxgrasp.model.faults"):
        in_a_new_process(f"import {name}")
        importlib.import_module(name)
