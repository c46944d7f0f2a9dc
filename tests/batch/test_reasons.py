"""Reasons why a grasp does not hold, on grasps that are made to fail for one reason alone."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import linprog
from scipy.spatial.transform import Rotation

import jaxgrasp
from jaxgrasp.batch.contact_sets import ContactSets
from jaxgrasp.batch.reasons import Reason

X, Y, Z = np.eye(3)


def grasps(*problems, friction=0.5, squeeze=2.0, turn=True, **more) -> ContactSets:
    """Return grasps of ``(points, normals, wrench)``, turned and moved so that nothing lies along an axis."""
    rotation = Rotation.from_rotvec([0.3, -0.5, 0.8]).as_matrix() if turn else np.eye(3)
    away = np.array([0.2, -0.1, 0.4])
    points, normals, wrenches, sizes = [], [], [], []
    for p, n, w in problems:
        points.append(np.array(p) @ rotation.T + away)
        normals.append(np.array(n, float) @ rotation.T)
        force, torque = rotation @ w[:3], rotation @ w[3:]
        wrenches.append(np.concatenate([force, torque + np.cross(away, force)]))
        sizes.append(len(p))
    count = sum(sizes)
    columns = {"friction": np.full(count, friction), "squeeze": np.full(count, squeeze)}
    columns |= {name: np.full(count, value) for name, value in more.items()}
    offsets = np.concatenate([[0], np.cumsum(sizes)])
    return ContactSets(
        np.concatenate(points), np.concatenate(normals), offsets=offsets, wrench=np.array(wrenches)[:, None], **columns
    )


JAW = ([0.03 * X, -0.03 * X], [-X, X])
TABLE = ([0.05 * X, -0.03 * X + 0.04 * Y, -0.03 * X - 0.04 * Y], [Z, Z, Z])
WRENCH = {
    Reason.HOLDS: (*TABLE, np.array([0, 0, 2.0, 0, 0, 0])),
    Reason.LINE: (*JAW, np.array([0, 0, 1.0, 0.01, 0, 0])),
    Reason.POINT: ([np.zeros(3)], [Z], np.array([0, 0, 1.0, 0, 0, 0.01])),
    Reason.PULL: (*TABLE, np.array([0, 0, -1.0, 0, 0, 0])),
    Reason.FRICTION: (*TABLE, np.array([3.0, 0, 2.0, 0, 0, 0])),
}


@pytest.mark.parametrize("methods", [("A", "A-optimum"), ("B-optimum",)], ids="+".join)
@pytest.mark.parametrize("dtype", ["float64", pytest.param("float32", marks=pytest.mark.slow)])
def test_each_grasp_fails_for_the_reason_that_it_was_made_for(methods, dtype):
    evaluation = jaxgrasp.evaluate(grasps(*WRENCH.values()), methods=methods, dtype=dtype)
    assert [Reason(int(code)) for code in evaluation.why[:, 0]] == list(WRENCH)
    assert evaluation.summary.ranked.counts[Reason.LINE] == 1


@pytest.mark.slow
def test_torsion_mends_the_jaw_that_turns_about_its_line():
    sets = grasps(WRENCH[Reason.LINE], torsion=0.01)
    assert jaxgrasp.evaluate(sets, methods=("A-optimum",)).why.item() == Reason.HOLDS


@pytest.mark.slow
def test_limits_are_blamed_where_the_proof_needs_them():
    push = (*TABLE, np.array([0, 0, 40.0, 0, 0, 0]))
    sets = grasps(push, WRENCH[Reason.FRICTION], push, normal_max=10.0)
    why = jaxgrasp.evaluate(sets, methods=("A-optimum",)).why[:, 0]
    assert why.tolist() == [Reason.LIMITS, Reason.FRICTION, Reason.LIMITS]


def test_a_closed_form_alone_does_not_say_that_nothing_holds():
    evaluation = jaxgrasp.evaluate(grasps(WRENCH[Reason.FRICTION]), methods=("A",))
    assert evaluation.why.item() == Reason.SLIPS
    assert evaluation.table()["holds"].tolist() == ["unknown"]


def holds_by_any_friction(points, normals, wrench) -> bool:
    """Return True where contact forces that push, in whatever direction, give the wrench: a linear program."""
    n = len(points)
    balance = np.zeros((6, 3 * n))
    for i, point in enumerate(points):
        balance[:3, 3 * i : 3 * i + 3] = np.eye(3)
        balance[3:, 3 * i : 3 * i + 3] = np.cross(np.eye(3), point).T @ -np.eye(3)
    push = np.zeros((n, 3 * n))
    for i, normal in enumerate(normals):
        push[i, 3 * i : 3 * i + 3] = -normal
    made = linprog(np.zeros(3 * n), push, np.zeros(n), balance, wrench, bounds=(None, None), method="highs")
    return made.status == 0


@pytest.mark.filterwarnings("ignore:normals of")
@pytest.mark.parametrize("kind", ["tray", "sphere", "box"])
def test_friction_is_blamed_where_more_of_it_would_hold_and_nowhere_else(kind):
    rng = np.random.default_rng(len(kind))
    problems = []
    for _ in range(60):
        n = int(rng.integers(2, 6))
        points = rng.normal(size=(n, 3))
        if kind == "tray":
            points[:, 2], normals = 0, np.tile(Z, (n, 1))
        elif kind == "sphere":
            points /= np.linalg.norm(points, axis=1, keepdims=True)
            normals = -points
        else:
            normals = np.sign(rng.normal(size=(n, 1))) * np.eye(3)[rng.integers(0, 3, n)]
        problems.append((0.05 * points, normals, np.append(rng.normal(size=3), 0.05 * rng.normal(size=3))))
    sets = grasps(*problems, friction=0.3, turn=False)
    reasons = jaxgrasp.evaluate(sets, methods=("A-optimum",)).why[:, 0]
    reasons_met = set()
    for (points, normals, _), code, wrench in zip(problems, reasons, sets.wrench[:, 0]):
        reason = Reason(int(code))
        reasons_met.add(reason)
        away = np.array([0.2, -0.1, 0.4])
        any_friction = holds_by_any_friction(np.array(points) + away, normals, wrench)
        if reason in (Reason.FRICTION, Reason.HOLDS):
            assert any_friction
        elif reason in (Reason.PULL, Reason.LINE, Reason.POINT):
            assert not any_friction
    assert Reason.FRICTION in reasons_met and (Reason.PULL in reasons_met or kind != "tray")


@pytest.mark.slow
def test_a_tray_that_is_pulled_down_and_aside_would_have_to_pull():
    tray = ([np.zeros(3), 0.03 * X + 0.01 * Y, 0.03 * Y], [Z, Z, Z], np.array([1.0, 0, -1, 0, 0, 0]))
    for limits in ({}, {"normal_max": 10.0}):
        evaluation = jaxgrasp.evaluate(grasps(tray, **limits), methods=("A-optimum",))
        assert evaluation.why.item() == Reason.PULL


@pytest.mark.slow
def test_contacts_that_carry_nothing_are_on_no_line():
    sets = grasps((*JAW, np.array([0, 0, 0, 0, 0, 0.1])))
    sets = replace(sets, squeeze=np.array([10.0, 0.0]))
    assert jaxgrasp.evaluate(sets, methods=("B-optimum",)).why.item() == Reason.POINT


@pytest.mark.slow
def test_each_wrench_of_a_grasp_has_its_own_reason():
    single = grasps(WRENCH[Reason.FRICTION], turn=False)
    down = single.wrench.copy()
    down[0, 0] = np.concatenate([-Z, np.cross([0.2, -0.1, 0.4], -Z)])
    combined = replace(single, wrench=np.concatenate([single.wrench, down], 1))
    assert jaxgrasp.evaluate(combined, methods=("A-optimum",)).why.tolist() == [[Reason.FRICTION, Reason.PULL]]
