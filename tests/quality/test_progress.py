"""Long batches say how far they are, and end where they are told to."""

import numpy as np
import pytest

from jaxgrasp.quality import ferrari_canny, force_closure, largest_wrench, min_weight
from jaxgrasp.quality.grasp_input import MANY_TOGETHER, TOGETHER
from tests.quality import known

REMAINDER = 44
TASK = np.eye(6)[0]
MEASURES = {
    "closure": (MANY_TOGETHER, lambda grasp, **more: force_closure(grasp, **more).margin),
    "ball": (TOGETHER, lambda grasp, **more: ferrari_canny(grasp, tol=0.1, **more).upper),
    "wrench": (TOGETHER, lambda grasp, **more: largest_wrench(grasp, TASK, "l1", **more).upper),
    "weight": (MANY_TOGETHER, lambda grasp, **more: min_weight(grasp, **more).value),
}
FIELDS = ("points", "normals", "friction", "squeeze")


@pytest.mark.parametrize(("together", "measure"), MEASURES.values(), ids=MEASURES)
def test_every_grasp_is_told_of_once_and_a_part_is_as_the_whole(together, measure):
    counts: list[int] = []
    many = known.ordinary(3, together + REMAINDER)
    result = measure(many, progress=counts.append)
    assert counts == [together, REMAINDER]
    last = measure(known.changed(many, **{f: getattr(many, f)[together:] for f in FIELDS}))
    # A batch of another size is read with other last digits.
    np.testing.assert_allclose(result[together:], last, rtol=1e-9, atol=1e-13)


def test_what_progress_raises_ends_the_work():
    class Stop(Exception):
        pass

    counts = []

    def stop(grasps: int) -> None:
        counts.append(grasps)
        raise Stop

    with pytest.raises(Stop):
        ferrari_canny(known.ordinary(3, TOGETHER + REMAINDER), tol=0.1, progress=stop)
    assert counts == [TOGETHER]


def test_a_batch_of_none_has_no_answers():
    none = known.changed(known.ordinary(3, 1), **{f: getattr(known.ordinary(3, 1), f)[:0] for f in FIELDS})
    assert ferrari_canny(none).upper.shape == (0,) and force_closure(none).closed.shape == (0,)
