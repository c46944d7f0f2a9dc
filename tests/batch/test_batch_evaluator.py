"""Bitwise equality of a worker's answers for batches of rows and those of ``evaluate``, in any batch size and order."""

import pickle
import re
import subprocess
import sys
from dataclasses import replace

import jax
import numpy as np
import pytest

import jaxgrasp
from jaxgrasp.batch import BatchEvaluator
from jaxgrasp.batch.contact_sets import ContactSets
from jaxgrasp.batch.evaluation import evaluate
from jaxgrasp.batch.file_error import GraspFileError
from tests.batch.conftest import make_sets

METHODS = ("B", "B-optimum")
SIZES = [3, 5, 4, 2, 5, 3]


@pytest.fixture(scope="module")
def sets() -> ContactSets:
    made = make_sets(SIZES * 12)
    names = np.array([f"grasp {number}" for number in range(len(made))])
    # Two contacts resist no torque about their line, and few such a torque about any.
    made.wrench[3::6] = [0, 0, 0, 0, 0, 5]
    return replace(made, labels={"name": names})


@pytest.fixture(scope="module")
def expected(sets) -> dict[str, np.ndarray]:
    return evaluate(sets, methods=METHODS).table()


@pytest.fixture(scope="module")
def evaluator() -> BatchEvaluator:
    return BatchEvaluator(METHODS, contacts=(6,), rows=128)


def objects(rows: list) -> np.ndarray:
    made = np.empty(len(rows), object)
    made[:] = rows
    return made


def as_batch(sets: ContactSets) -> dict[str, np.ndarray]:
    """Return one row for each grasp, in the columns that Ray or pandas passes to a worker."""
    cut = {name: objects(np.split(array, sets.offsets[1:-1])) for name, array in sets.columns.items()}
    return cut | {"wrench": sets.wrench[:, 0], **sets.labels}


def assert_same(result: dict, expected: dict, rows: np.ndarray) -> None:
    for name, values in expected.items():
        if name != "grasp":
            np.testing.assert_array_equal(result[name], values[rows], err_msg=name)


def test_rows_are_evaluates_to_the_last_bit_whatever_the_batch_and_the_order(sets, expected, evaluator):
    rng = np.random.default_rng(0)
    for count in (1, 7, len(sets)):
        rows = rng.permutation(len(sets))[:count]
        assert_same(evaluator(as_batch(sets.rows(rows))), expected, rows)
    assert {"yes", "no"} <= set(expected["holds"])


def test_forces_stand_by_row(sets, evaluator):
    columns, result = evaluator(as_batch(sets)), evaluate(sets, methods=METHODS).results["B-optimum"]
    forces = columns["B-optimum.forces"]
    assert forces.dtype == object and [len(row) for row in forces] == sets.sizes.tolist()
    np.testing.assert_array_equal(np.concatenate(forces), result.forces[:, 0])
    equal = sets.rows(np.flatnonzero(sets.sizes == 5))
    assert evaluator(as_batch(equal))["B-optimum.forces"].shape == (len(equal), 5, 3)


def test_an_arrow_table_and_plain_arrays_say_the_same(sets, expected, evaluator, tmp_path):
    parquet = pytest.importorskip("pyarrow.parquet")
    jaxgrasp.save_grasps(tmp_path / "sets.parquet", sets)
    assert_same(evaluator(parquet.read_table(tmp_path / "sets.parquet")), expected, np.arange(len(sets)))
    rows = np.flatnonzero(sets.sizes == 4)
    grasp = sets.rows(rows).padded(4)
    plain = {name: np.asarray(getattr(grasp, name)) for name in ("points", "normals", "friction", "squeeze")}
    plain |= {"wrench": sets.wrench[rows, 0], "name": sets.labels["name"][rows], "other": np.zeros(len(rows))}
    columns = evaluator(plain)
    assert_same(columns, expected, rows)
    assert "other" not in columns


def test_a_copy_that_was_sent_says_the_same_and_leaves_the_mode_alone(sets, expected, evaluator):
    sent = pickle.loads(pickle.dumps(evaluator))
    assert sent == evaluator
    with jax.enable_x64(False):
        assert_same(sent(as_batch(sets)), expected, np.arange(len(sets)))
        assert not jax.config.jax_enable_x64


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"friction": objects([np.ones(2)] * 72)}, "batch: friction[0] has 2 contacts: expected 3, as the others"),
        ({"wrench": np.zeros((72, 5))}, "batch: wrench has shape (72, 5)"),
        ({"points": objects([[[1.0, 2.0], [1.0]]] * 72)}, "batch: points holds rows that do not fit together"),
        ({"squeeze": objects(["a"] * 72)}, "batch: squeeze holds"),
    ],
    ids=str,
)
def test_a_batch_that_does_not_fit_is_one_line(sets, evaluator, change, message):
    with pytest.raises(GraspFileError, match=re.escape(message)) as raised:
        evaluator(as_batch(sets) | change)
    assert "\n" not in str(raised.value)


def test_a_batch_that_cannot_be_used_is_said(sets, evaluator):
    with pytest.raises(GraspFileError, match="it lacks 'wrench'"):
        evaluator({name: column for name, column in as_batch(sets).items() if name != "wrench"})
    with pytest.raises(TypeError, match="batch is a list: expected a dict of arrays or an Arrow table"):
        evaluator([1])
    with pytest.raises(ValueError, match="grasp 0 has 3 contacts: expected at most 2"):
        replace(evaluator, contacts=(2,))(as_batch(sets))
    bad = as_batch(sets)
    bad["wrench"] = bad["wrench"].copy()
    bad["wrench"][4, 0] = np.nan
    with pytest.raises(jaxgrasp.GraspError, match=r"wrench\[4\]"):
        evaluator(bad)
    with pytest.raises(ValueError, match="grasp 5 has 3 contacts: expected at most 2"):
        bad["wrench"][:5, 0] = np.nan
        replace(evaluator, contacts=(2,), skip_bad=True)(bad)
    bad["wrench"][:4] = as_batch(sets)["wrench"][:4]
    columns = replace(evaluator, skip_bad=True)(bad)
    assert len(columns["name"]) == len(sets) - 1 and "grasp 4" not in columns["name"]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"methods": ("C",)}, "method 'C' is unknown"),
        ({"quality": ("luck",)}, "luck"),
        ({"dtype": "float16"}, "dtype is 'float16': expected"),
        ({"rows": 0}, "rows is 0: expected"),
        ({"contacts": (4, 2)}, "in ascending order"),
        ({"contacts": ()}, "contacts is ()"),
    ],
)
def test_options_that_cannot_be_are_said_at_once(options, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        BatchEvaluator(**options)


ONE_CORE = """
import os, pickle, sys
os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
evaluator, batch = pickle.load(sys.stdin.buffer)
sys.stdout.buffer.write(pickle.dumps(evaluator(batch)))
"""


@pytest.mark.slow
def test_a_worker_with_one_core_says_the_same_of_every_kind_of_problem(expected):
    pytest.importorskip("os").sched_getaffinity(0)
    sets = mixed(5)
    evaluator = BatchEvaluator(contacts=(6,), rows=512)
    with pytest.warns(UserWarning, match="point away from the middle"):
        local_columns = evaluate(sets).table()
    pickled_job = pickle.dumps((evaluator, as_batch(sets)))
    done = subprocess.run([sys.executable, "-c", ONE_CORE], input=pickled_job, capture_output=True, check=True)
    assert_same(pickle.loads(done.stdout), local_columns, np.arange(len(sets)))
    some = np.random.default_rng(0).permutation(len(sets))[:100]
    assert_same(evaluator(as_batch(sets.rows(some))), local_columns, some)


def mixed(n: int) -> ContactSets:
    """Return problems of the kinds that together need every phase of the solver."""
    from jaxgrasp.testing.problems import problems

    kinds = ("ordinary", "combined", "infeasible", "near_collinear", "some_zero_squeeze", "zero_friction", "scales")
    drawn = [problems(kind, n, 200, seed=1) for kind in kinds]
    column = {
        name: np.concatenate([getattr(part, name) for part in drawn]) for name in ("points", "normals", "friction")
    }
    squeeze, wrench = (np.concatenate([getattr(part, name) for part in drawn]) for name in ("squeeze", "wrench"))
    grasp = jaxgrasp.Grasp(*column.values(), squeeze)
    return replace(
        ContactSets.from_grasp(grasp, wrench), labels={"name": np.array([str(k) for k in range(len(wrench))])}
    )
