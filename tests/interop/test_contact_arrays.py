"""Contacts of plain arrays: each in its world, in its order, the normals inward; and every recipe of the docs."""

import importlib.util
import subprocess
import sys
from pathlib import Path

import jax
import numpy as np
import pytest

from jaxgrasp.interop import from_contact_arrays

N, WORLDS, PLACES = 40, 6, 4
RECIPES = {"pybullet": "pybullet", "pydrake": "drake", "sapien": "sapien", "newton": "newton", "genesis": "genesis"}
"""Packages that pip installs and that run without a GPU, and their recipes."""
PIP_NAMES = {"genesis": "genesis-world"}
FOLDER = Path(__file__).parents[2] / "docs" / "simulators"


def listed():
    rng = np.random.default_rng(0)
    points, normals, forces = rng.normal(size=(3, N, 3))
    return points, normals, rng.uniform(0.2, 1, N), forces, np.arange(N), rng.integers(-1, WORLDS + 1, N)


def test_each_contact_finds_its_world_and_the_strongest_stay():
    points, normals, friction, forces, body, world = listed()
    center = np.random.default_rng(1).normal(size=(WORLDS, 3))

    @jax.jit
    def read(points, normals, forces, world):
        return from_contact_arrays(
            points, normals, friction, forces, body,
            direction="by_force", world=world, n_worlds=WORLDS, max_contacts=PLACES, center=center,
        )  # fmt: skip

    contacts = jax.device_get(read(points, normals, forces, world))
    np.testing.assert_allclose(np.linalg.norm(contacts.grasp.normals, axis=-1), 1, rtol=1e-12)
    along = np.sum(forces * normals, -1) / np.linalg.norm(normals, axis=-1)
    for number in range(WORLDS):
        own = np.flatnonzero(world == number)
        kept = np.sort(own[np.argsort(-np.abs(along[own]))[:PLACES]])
        count = len(kept)
        np.testing.assert_array_equal(contacts.bodies[number], np.append(kept, [-1] * (PLACES - count)))
        assert contacts.dropped[number] == len(own) - count
        np.testing.assert_array_equal(contacts.grasp.present[number], np.arange(PLACES) < count)
        np.testing.assert_allclose(contacts.grasp.points[number, :count], points[kept] - center[number], rtol=1e-12)
        np.testing.assert_allclose(contacts.grasp.squeeze[number, :count], np.abs(along[kept]), rtol=1e-12)
        np.testing.assert_allclose(contacts.forces[number, :count], forces[kept])
        assert (np.sum(contacts.forces * contacts.grasp.normals, -1) >= 0).all()
    assert (contacts.dropped > 0).any() and (contacts.grasp.present == 0).any()


def test_padded_arrays_and_lists_agree_and_normals_may_point_out():
    points, normals, friction, _, _, _ = listed()
    shaped = [x.reshape(8, 5, *x.shape[1:]) for x in (points, normals, friction)]
    padded = from_contact_arrays(*shaped, squeeze=2.0, direction="outward")
    listed_ = from_contact_arrays(points, -normals, friction, squeeze=2.0, world=np.repeat(np.arange(8), 5))
    for name in ("points", "normals", "friction", "squeeze", "present"):
        np.testing.assert_allclose(getattr(padded.grasp, name), getattr(listed_.grasp, name), rtol=1e-12)


def test_wrong_arguments_are_named():
    points, normals, friction, forces, _, world = listed()
    for match, change in (
        ("points has shape", {"points": points[0]}),
        ("normals has shape", {"normals": normals[:3]}),
        ("friction has shape", {"friction": friction[:3]}),
        ("forces has shape", {"forces": forces[:3]}),
        ("both None", {"forces": None}),
        ("by_force", {"forces": friction, "direction": "by_force"}),
        ("give world", {"max_contacts": 3}),
        ("n_worlds is 0", {"world": world, "n_worlds": 0}),
        ("body is a dict", {"body": {}}),
    ):
        arguments = {"points": points, "normals": normals, "friction": friction, "forces": forces} | change
        with pytest.raises(ValueError, match=match):
            from_contact_arrays(**arguments)
    with pytest.raises(ValueError, match="world is traced"):
        jax.jit(lambda world: from_contact_arrays(points, normals, friction, forces, world=world))(world)


@pytest.mark.parametrize("script", sorted(FOLDER.glob("*.py")), ids=lambda path: path.stem)
def test_recipes_are_short(script):
    assert sum(bool(line.strip()) for line in script.read_text().splitlines()) <= 30


@pytest.mark.slow
@pytest.mark.parametrize(("package", "name"), RECIPES.items())
def test_recipes_hold_the_box(package, name):
    if importlib.util.find_spec(package) is None:
        pytest.skip(f"{package} is missing: pip install {PIP_NAMES.get(name, name)}")
    script = FOLDER / f"{name}_contacts.py"
    run = subprocess.run([sys.executable, script], capture_output=True, text=True, timeout=300, check=False)
    assert run.returncode == 0, run.stderr
    margins = [float(word) for word in run.stdout.splitlines()[-1].split()]
    assert margins[0] > 1 and all(margin < -0.9 for margin in margins[1:])
