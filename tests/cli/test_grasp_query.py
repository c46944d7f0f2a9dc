"""A grasp is chosen by its name, or else by its number, whatever the parts in which a file is read."""

import numpy as np
import pytest

from jaxgrasp.cli.grasp_files import GraspQuery
from tests.report.test_short_titles import IMPORTED

NAMES = ["mug, left", "mug, right", "7", "two fingers", *IMPORTED, "twice", "twice"]


def number_of(query: str, names=NAMES, part: int = 3) -> int:
    chosen = GraspQuery(query)
    for first in range(0, len(names), part):
        chosen.look(np.array(names[first : first + part]), len(names[first : first + part]))
    return chosen.number("grasps.npz")


@pytest.mark.parametrize("part", [1, 2, 3, 100])
def test_each_name_is_found_before_a_number_is(part):
    for number, name in enumerate(NAMES[:-2]):
        assert number_of(name, part=part) == number
    for number in (0, 4, 6, 9):
        assert number_of(str(number), part=part) == number
    # The grasp whose name is 7 is not that of the number 7.
    assert number_of("7", part=part) == 2


def test_grasps_without_names_have_numbers():
    chosen = GraspQuery("4")
    for _ in range(2):
        chosen.look(None, 3)
    assert chosen.number("grasps.npz") == 4


@pytest.mark.parametrize(
    "query, message",
    [
        ("mug, lef", "^grasps.npz holds no grasp 'mug, lef': did you mean 'mug, left'( or .*)?\\?$"),
        ("two figners", "did you mean 'two fingers'\\?$"),
        ("mug", "did you mean '(mug, left', 'mug, right|mug, right', 'mug, left)'"),
        ("grasp 8", "did you mean .*grasp 00008, wrench 0'"),
        ("zzz", "expected a name, such as 'mug, left', 'mug, right', '7', or a number from 0 to 9$"),
        ("10", "holds no grasp '10': expected a number from 0 to 9$"),
        ("-1", "holds no grasp '-1'"),
        ("twice", "grasps 8 and 9 are both named 'twice': give a number$"),
        ("\x1b[2J", r"holds no grasp '\\x1b\[2J'"),
    ],
)
def test_an_unknown_name_lists_the_nearest(query, message):
    with pytest.raises(ValueError, match=message):
        number_of(query)
