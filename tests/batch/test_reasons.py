"""Why a grasp does not hold is what its proof shows, on grasps that are made to fail for one reason alone."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import jaxgrasp
from jaxgrasp.batch.contact_sets import ContactSets
from jaxgrasp.batch.reasons import Reason

X, Y, Z = np.eye(3)


def grasps(*each, friction=0.5, squeeze=2.0, turn=True, **more) -> ContactSets:
    """Of pairs (points, normals, wrench), turned and moved so that nothing stands on an axis."""
    rotation = Rotation.from_rotvec([0.3, -0.5, 0.8]).as_matrix() if turn else np.eye(3)
    away = np.array([0.2, -0.1, 0.4])
    points, normals, wrenches, sizes = [], [], [], []
    for p, n, w in each:
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
@pytest.mark.parametrize("dtype", ["float64", "float32"])
def test_each_grasp_fails_for_the_reason_that_it_was_made_for(methods, dtype):
    found = jaxgrasp.evaluate(grasps(*WRENCH.values()), methods=methods, dtype=dtype)
    assert [Reason(int(code)) for code in found.why[:, 0]] == list(WRENCH)
    assert found.summary.ranked.counts[Reason.LINE] == 1


def test_torsion_mends_the_jaw_that_turns_about_its_line():
    sets = grasps(WRENCH[Reason.LINE], torsion=0.01)
    assert jaxgrasp.evaluate(sets, methods=("A-optimum",)).why.item() == Reason.HOLDS


def test_limits_are_blamed_where_the_proof_needs_them():
    push = (*TABLE, np.array([0, 0, 40.0, 0, 0, 0]))
    sets = grasps(push, WRENCH[Reason.FRICTION], push, normal_max=10.0)
    why = jaxgrasp.evaluate(sets, methods=("A-optimum",)).why[:, 0]
    assert why.tolist() == [Reason.LIMITS, Reason.FRICTION, Reason.LIMITS]


def test_a_closed_form_alone_does_not_say_that_nothing_holds():
    found = jaxgrasp.evaluate(grasps(WRENCH[Reason.FRICTION]), methods=("A",))
    assert found.why.item() == Reason.SLIPS
    assert found.table()["holds"].tolist() == ["unknown"]
