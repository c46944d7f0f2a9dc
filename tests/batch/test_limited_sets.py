"""Soft fingers and limits in contact sets, files and evaluations."""

import dataclasses

import jax
import numpy as np
import pytest

import jaxgrasp
from jaxgrasp.batch import engine
from jaxgrasp.batch.contact_sets import OPTIONAL_FIELDS, ContactSets
from jaxgrasp.batch.shards import ResultFolder
from jaxgrasp.batch.sources import Adjustments, MemorySource
from jaxgrasp.batch.stream import StreamPlan, evaluate_stream
from jaxgrasp.cli.main import main
from jaxgrasp.model.grasp import BOUNDS
from jaxgrasp.testing.limited_problems import limited_problems

COUNT, N, JOINTS = 12, 4, 3
METHODS = ("B", "B-optimum")


@pytest.fixture(scope="module")
def made():
    return limited_problems("ordinary", N, COUNT, 3, soft=True, bounded=True, joints=JOINTS)


@pytest.fixture(scope="module")
def sets(made) -> ContactSets:
    return ContactSets.from_grasp(made.grasp, made.problem.wrench, made.limits)


@pytest.fixture(scope="module")
def uneven(sets) -> ContactSets:
    """Return the same sets with the last contact left out of every third grasp."""
    keep = np.ones((COUNT, N), bool)
    keep[::3, -1] = False
    columns = {name: array[keep.ravel()] for name, array in sets.columns.items()}
    return dataclasses.replace(sets, **columns, offsets=np.concatenate([[0], np.cumsum(keep.sum(1))]))


def assert_same(a: ContactSets, b: ContactSets, names) -> None:
    for name in (*names, "points", "friction", "offsets", "wrench"):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name), err_msg=name)


ALL = (*OPTIONAL_FIELDS, "torque_max")


def test_rows_and_padding_keep_what_belongs_together(made, sets, uneven):
    assert_same(sets.rows(slice(2, 5)), sets.rows(np.array([2, 3, 4])), ALL)
    for some_sets in (sets, uneven):
        padded, limits = some_sets.padded(6), some_sets.limits(6)
        assert limits is not None and limits.torque_map.shape == (COUNT, 6, 4, JOINTS)
        assert_same(ContactSets.from_grasp(padded, some_sets.wrench, limits), some_sets, ALL)
    np.testing.assert_array_equal(sets.limits(N).normal_max, made.limits.normal_max)


@pytest.mark.parametrize("which", ["sets", "uneven"])
def test_files_keep_every_bit(which, request, tmp_path):
    some_sets = request.getfixturevalue(which)
    jaxgrasp.save_grasps(tmp_path / "a.npz", some_sets)
    assert_same(jaxgrasp.load_grasps(tmp_path / "a.npz"), some_sets, ALL)
    plain = dataclasses.replace(some_sets, torque_map=None, torque_max=None)
    jaxgrasp.save_grasps(tmp_path / "a.csv", plain)
    assert_same(jaxgrasp.load_grasps(tmp_path / "a.csv"), plain, OPTIONAL_FIELDS[:3])
    with pytest.raises(ValueError, match=r"torque_map is given: .* write an .npz file"):
        jaxgrasp.save_grasps(tmp_path / "b.csv", some_sets)


def test_friction_of_zero_leaves_none_for_turning_either(sets):
    assert sets.torsion.any()
    slick = Adjustments(friction=0.0).apply(sets)
    assert not slick.friction.any() and not slick.torsion.any() and not list(slick.faults())
    np.testing.assert_array_equal(Adjustments(friction=0.5).apply(sets).torsion, sets.torsion)


def test_info_says_what_limits_a_file_holds(sets, tmp_path, capsys):
    jaxgrasp.save_grasps(tmp_path / "a.npz", sets)
    assert main(["info", str(tmp_path / "a.npz")]) == 0
    output = capsys.readouterr().out
    for name in ("torsion", "normal_min", "normal_max", "torque_max"):
        array = getattr(sets, name)
        assert f"{name:10} {array.min():.4g} to {array.max():.4g}" in output
    assert f"joints     {JOINTS}\n" in output


def test_a_batch_with_limits_is_saved_as_it_is_evaluated(made, sets, tmp_path):
    jaxgrasp.save_grasps(tmp_path / "a.npz", made.grasp, made.problem.wrench, limits=made.limits)
    assert_same(jaxgrasp.load_grasps(tmp_path / "a.npz"), sets, ALL)
    with pytest.raises(ValueError, match="limits is given: expected None with contact sets"):
        jaxgrasp.save_grasps(tmp_path / "b.npz", sets, limits=made.limits)


@pytest.fixture(scope="module")
def results(uneven):
    return jaxgrasp.evaluate(uneven, methods=METHODS).results


@pytest.mark.slow
def test_evaluations_are_those_of_the_plain_functions(uneven, results):
    optimum, closed = results["B-optimum"], results["B"]
    grasp, limits, wrench = uneven.padded(N), uneven.limits(N), uneven.wrench[:, 0]
    is_present = np.arange(N) < uneven.sizes[:, None]
    plain = jax.device_get(jaxgrasp.constrained_optimum(grasp, wrench, limits=limits))
    # The same solver on the same batch: apart by rounding alone.
    for name in ("forces", "moments", "normal_multiplier"):
        expected = getattr(plain, name)[is_present]
        np.testing.assert_allclose(getattr(optimum, name)[:, 0], expected, rtol=1e-6, atol=1e-7, err_msg=name)
    for name in ("verdict", "torque_multiplier", "certificate_rates"):
        np.testing.assert_allclose(getattr(optimum, name)[:, 0], getattr(plain, name), rtol=1e-6, atol=1e-7)
    assert np.any(optimum.torque_multiplier) and np.any(optimum.normal_multiplier)
    margin = np.asarray(jaxgrasp.friction_margin(grasp, plain.forces, plain.moments)).min(1)
    np.testing.assert_allclose(optimum.margin[:, 0], margin, atol=1e-6)
    free = jaxgrasp.closed_form(grasp, wrench)
    np.testing.assert_allclose(closed.forces[:, 0], np.asarray(free.forces)[is_present], rtol=1e-9, atol=1e-9)
    assert closed.torque_multiplier is None


@pytest.mark.slow
def test_streams_write_moments_and_multipliers(uneven, results, tmp_path):
    plan, source = StreamPlan(methods=METHODS, chunk=COUNT), MemorySource(uneven)
    folder = ResultFolder(tmp_path, plan.identity("data", source), resume=False)
    evaluate_stream(source, plan, folder)
    with np.load(tmp_path / "results.npz") as stored:
        for name in ("moments", "normal_multiplier", "torque_multiplier", "certificate_rates"):
            np.testing.assert_array_equal(
                stored[f"B-optimum.{name}"], getattr(results["B-optimum"], name), err_msg=name
            )
        assert "B.moments" in stored and "B.torque_multiplier" not in stored


def test_several_wrenches_share_their_grasp_s_limits(sets):
    twice = dataclasses.replace(sets, wrench=np.concatenate([sets.wrench, 0.5 * sets.wrench], 1))
    (block,) = engine.blocks(twice, 1, 1)
    assert block.limits is not None and block.limits.torque_max.shape == (engine.LEAST_BLOCK, JOINTS)
    assert 2 * COUNT < engine.LEAST_BLOCK
    np.testing.assert_array_equal(block.limits.torque_max[0], block.limits.torque_max[1])


@pytest.mark.parametrize(
    ("field", "place", "value", "words"),
    [
        ("torsion", 5, -1.0, ["torsion[1, 1]", "-1.0", "zero or more"]),
        ("normal_min", 6, np.nan, ["normal_min[1, 2]", "nan", "finite"]),
        ("normal_max", 7, 0.0, ["normal_max[1, 3]", "0.0", "no less than normal_min"]),
        ("torque_map", (8, 2, 1), np.inf, ["torque_map[2, 0, 2, 1]", "inf", "finite"]),
        ("torque_max", (9, 2), -2.0, ["torque_max[9, 2]", "-2.0", "zero or more"]),
    ],
)
def test_a_fault_names_field_index_value_and_expectation(sets, field, place, value, words):
    array = getattr(sets, field).copy()
    array[place] = value
    (fault,) = dataclasses.replace(sets, **{field: array}).faults()
    for word in words:
        assert word in str(fault)
    numbered = next(dataclasses.replace(sets, **{field: array}).faults(first_grasp=100))
    assert numbered.index[0] == fault.index[0] + 100


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"torque_max": None}, "has 'torque_map' and lacks 'torque_max'"),
        ({"torque_map": None}, "has 'torque_max' and lacks 'torque_map'"),
        ({"torsion": np.zeros((COUNT, N - 1))}, r"torsion has shape \(12, 3\): expected \(12, 4\)"),
        (
            {"torque_map": np.zeros((COUNT, N, 2, JOINTS))},
            r"torque_map has shape .*: expected \(12, 4, 3 or 4, joints\)",
        ),
        ({"torque_max": np.zeros((COUNT, 5))}, r"torque_max has shape \(12, 5\): expected \(12, 3\)"),
    ],
)
def test_files_of_shapes_that_do_not_fit_are_refused(sets, tmp_path, changed, words):
    path = tmp_path / "a.npz"
    jaxgrasp.save_grasps(path, sets)
    with np.load(path) as stored:
        columns = dict(stored) | changed
    np.savez(path, **{name: array for name, array in columns.items() if array is not None})
    with pytest.raises(jaxgrasp.GraspFileError, match=words):
        jaxgrasp.load_grasps(path)


def test_what_a_csv_file_cannot_hold_is_said(tmp_path):
    (tmp_path / "a.csv").write_text("grasp,torque_max\n0,1\n")
    with pytest.raises(jaxgrasp.GraspFileError, match=r"torque_max: .* need an .npz file"):
        jaxgrasp.load_grasps(tmp_path / "a.csv")


def test_limits_of_no_joints_are_refused(made):
    limits = jaxgrasp.Limits(torque_map=np.zeros((COUNT, N, 3, 0)), torque_max=np.zeros((COUNT, 0)))
    with pytest.raises(jaxgrasp.GraspError, match="torque_map is an array of shape .*3 or 4, joints"):
        jaxgrasp.evaluate(made.grasp, made.problem.wrench, limits=limits)


def test_limits_of_another_shape_are_refused(made):
    shorter = jaxgrasp.Limits(normal_max=made.limits.normal_max[:-1])
    with pytest.raises(jaxgrasp.GraspError, match="normal_max is an array of shape"):
        jaxgrasp.evaluate(made.grasp, made.problem.wrench, limits=shorter)
    assert set(BOUNDS) == {"normal_min", "normal_max", "torque_map", "torque_max"}
