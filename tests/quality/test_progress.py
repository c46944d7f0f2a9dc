"""Long batches say how far they are, and end where they are told to."""

import numpy as np
import pytest

from jaxgrasp.quality import ferrari_canny, force_closure, largest_wrench, min_weight
from jaxgrasp.quality.in_turn import TOGETHER
from tests.quality import known

COUNT = TOGETHER + 44
TASK = np.eye(6)[0]
MEASURES = {
    "closure": lambda grasp, **more: force_closure(grasp, **more).margin,
    "ball": lambda grasp, **more: ferrari_canny(grasp, tol=0.1, **more).upper,
    "wrench": lambda grasp, **more: largest_wrench(grasp, TASK, "l1", **more).upper,
    "weight": lambda grasp, **more: min_weight(grasp, **more).value,
}


@pytest.fixture(scope="module")
def many():
    return known.ordinary(3, COUNT)


@pytest.mark.parametrize("name", MEASURES)
def test_every_grasp_is_told_of_once_and_a_part_is_as_the_whole(many, name):
    told: list[int] = []
    found = MEASURES[name](many, progress=told.append)
    assert told == [TOGETHER, 44]
    last = MEASURES[name](known.changed(many, **{f: getattr(many, f)[TOGETHER:] for f in FIELDS}))
    np.testing.assert_array_equal(found[TOGETHER:], last)


FIELDS = ("points", "normals", "friction", "squeeze")


def test_what_progress_raises_ends_the_work(many):
    class Stop(Exception):
        pass

    told = []

    def stop(grasps: int) -> None:
        told.append(grasps)
        raise Stop

    with pytest.raises(Stop):
        ferrari_canny(many, tol=0.1, progress=stop)
    assert told == [TOGETHER]


def test_a_batch_of_none_has_no_answers():
    none = known.changed(known.ordinary(3, 1), **{f: getattr(known.ordinary(3, 1), f)[:0] for f in FIELDS})
    assert ferrari_canny(none).upper.shape == (0,) and force_closure(none).closed.shape == (0,)
