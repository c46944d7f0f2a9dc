"""The file of simulated grips obeys its format and the laws of statics, and single samples come out again."""

import importlib.util
import json
from pathlib import Path

import numpy as np
import pytest

from jaxgrasp.model.faults import value_faults

PATH = Path(importlib.util.find_spec("jaxgrasp").submodule_search_locations[0]) / "data" / "simulated_grips.npz"
STILL = 0.01
"""Unbalanced share of a weight that still counts as rest: its force, and its torque over the set's reach."""


@pytest.fixture(scope="module")
def sets():
    with np.load(PATH, allow_pickle=False) as file:
        return {name: file[name] for name in file.files}


def per_set(sets, values):
    return np.add.reduceat(values, sets["offsets"][:-1])


def test_file_is_small_and_large_enough(sets):
    assert PATH.stat().st_size <= 2_000_000
    assert len(sets["name"]) >= 2000
    assert sets["version"] == 1


def test_columns_fit_together(sets):
    rows, count = len(sets["points"]), len(sets["name"])
    assert sets["offsets"].dtype == np.int64 and sets["offsets"][0] == 0 and sets["offsets"][-1] == rows
    for name in ("normals", "friction", "squeeze", "depth", "normal_force", "simulated_force", "link"):
        assert len(sets[name]) == rows, name
    for name in ("wrench", "source", "object", "hand", "grip", "mass", "sample"):
        assert len(sets[name]) == count, name
    assert len(set(sets["name"])) == len(set(sets["sample"])) == count


def test_sets_are_diverse(sets):
    n = np.diff(sets["offsets"])
    sizes, sets_of_size = np.unique(n, return_counts=True)
    assert sizes.tolist() == list(range(2, 21))
    assert sets_of_size.min() >= 10 and sets_of_size[0] >= 100
    assert set(sets["object"]) == {"sphere", "cylinder", "box", "capsule"}
    for column, least in (("hand", 0.4), ("grip", 0.2), ("object", 0.15)):
        shares = np.unique(sets[column], return_counts=True)[1] / len(n)
        assert shares.min() >= least, column
    for hand in set(sets["hand"]):
        assert np.mean(sets["grip"][sets["hand"] == hand] == "precision") >= 0.2, hand


def test_values_have_no_faults(sets):
    assert not list(value_faults(sets["points"], sets["normals"], sets["friction"], sets["squeeze"]))


def test_simulated_forces_hold_the_object(sets):
    force = per_set(sets, sets["simulated_force"])
    torque = per_set(sets, np.cross(sets["points"], sets["simulated_force"]))
    weight = np.linalg.norm(sets["wrench"][:, :3], axis=-1)
    reach = np.sqrt(np.maximum.reduceat((sets["points"] ** 2).sum(-1), sets["offsets"][:-1]))
    np.testing.assert_allclose(weight, 9.81 * sets["mass"], rtol=1e-6)
    assert (np.linalg.norm(force - sets["wrench"][:, :3], axis=-1) <= STILL * weight).all()
    assert (np.linalg.norm(torque - sets["wrench"][:, 3:], axis=-1) <= STILL * weight * reach).all()


def test_simulated_forces_lie_in_their_cones(sets):
    forces, normals = sets["simulated_force"], sets["normals"]
    pressing = np.einsum("ij,ij->i", forces, normals)
    sliding = np.linalg.norm(forces - pressing[:, None] * normals, axis=-1)
    np.testing.assert_allclose(pressing, sets["normal_force"], atol=1e-5)
    assert (sliding <= sets["friction"] * pressing + 1e-5).all()


def test_squeeze_is_eq_6_with_one_stiffness(sets):
    np.testing.assert_allclose(sets["squeeze"], sets["stiffness"] * sets["depth"], rtol=1e-6)
    ratio = per_set(sets, sets["squeeze"]) / per_set(sets, sets["normal_force"])
    assert np.median(ratio) == pytest.approx(1, abs=1e-3)


def test_objects_are_in_the_hand(sets):
    assert np.abs(sets["points"]).max() < 0.15
    assert sets["depth"].min() > 0 and sets["depth"].max() <= 0.005


def test_report_counts_what_the_file_holds(sets):
    report = json.loads(PATH.with_suffix(".json").read_text(encoding="utf-8"))
    outcomes = report["outcomes"]
    assert outcomes["kept"] == len(sets["name"]) == sum(report["kept"].values())
    assert sum(outcomes.values()) == report["attempted"] == sets["sample"][-1] + 1
    counted = np.unique(np.diff(sets["offsets"]), return_counts=True)
    assert report["sets by number of contacts"] == {
        str(n): k for n, k in zip(*map(np.ndarray.tolist, counted), strict=True)
    }


@pytest.mark.slow
@pytest.mark.parametrize("row", [0, 700, 1400, 1999])
def test_a_sample_comes_out_again(sets, row):
    """Laws, not bits: another machine may round its way to other contacts, but not to another physics."""
    close = pinned_generator()
    grip = close.simulate(int(sets["seed"]), int(sets["sample"][row]))
    assert (grip.outcome, grip.hand, grip.shape) == ("kept", sets["hand"][row], sets["object"][row])
    assert grip.held_object.mass == pytest.approx(sets["mass"][row], rel=1e-6)
    grasp, forces = grip.contacts.grasp, grip.contacts.forces
    assert not list(value_faults(grasp.points, grasp.normals, grasp.friction, grasp.squeeze))
    reached = np.concatenate([forces.sum(0), np.cross(grasp.points, forces).sum(0)])
    weight, reach = np.linalg.norm(grip.contacts.wrench[:3]), np.linalg.norm(grasp.points, axis=-1).max()
    assert np.linalg.norm((reached - grip.contacts.wrench)[:3]) <= STILL * weight
    assert np.linalg.norm((reached - grip.contacts.wrench)[3:]) <= STILL * weight * reach
    sliding = np.linalg.norm(forces - grasp.squeeze[:, None] * grasp.normals, axis=-1)
    assert (sliding <= grasp.friction * grasp.squeeze + 1e-6 * weight).all()


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:body 'object' is loaded by passive forces")
def test_a_sample_depends_on_its_seed_and_number_only(sets):
    close = pinned_generator()
    sample = int(sets["sample"][1])
    first, _, again = (close.simulate(0, number) for number in (sample, sample + 1, sample))
    np.testing.assert_array_equal(first.contacts.forces, again.contacts.forces)
    other_sample = close.simulate(1, sample)
    assert other_sample.held_object != first.held_object


def pinned_generator():
    """Return the generator module; skip where the hand models and the engine that made the file are not installed."""
    mujoco = pytest.importorskip("mujoco")
    for package in ("myo_sim", "gymnasium_robotics"):
        if importlib.util.find_spec(package) is None:
            pytest.skip(f"needs {package}")
    made_with = json.loads(PATH.with_suffix(".json").read_text(encoding="utf-8"))["versions"]["mujoco"]
    if mujoco.__version__ != made_with:
        pytest.skip(f"the file was made with MuJoCo {made_with}")
    return pytest.importorskip("benchmarks.contact_sets.close")
