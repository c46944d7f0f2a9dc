"""Grippers of two parallel jaws by their names."""

from typing import NamedTuple

import numpy as np

from jaxgrasp.cli.import_arguments import ImportGrippers
from jaxgrasp.hand.parallel_jaw import parallel_jaw
from jaxgrasp.model.hand import Hand


class _Sizes(NamedTuple):
    opening: float
    pads: tuple[float, float]


SIZES = {
    "franka": _Sizes(0.08, (0.0941, 0.1122)),
    "robotiq-2f-85": _Sizes(0.085, (0.1125, 0.1475)),
    "robotiq-2f-140": _Sizes(0.136, (0.165, 0.225)),
}
"""[m]: of the Franka hand in ACRONYM's frame; of the Robotiq grippers in that of their base, where GraspGen has the
regions in which they close. Their pads swing as they close, here they slide."""


def gripper(arguments: ImportGrippers) -> tuple[Hand, np.ndarray]:
    """Return the parallel jaw, and the rotation ``(4, 4)`` from its frame to the files'."""
    sizes = SIZES[arguments.gripper]
    opening = sizes.opening if arguments.opening is None else arguments.opening
    jaw = parallel_jaw(opening, reach=sizes.pads if arguments.pads is None else arguments.pads)
    turned = np.eye(4)
    if arguments.closes_along == "y":
        turned[:2, :2] = [[0, -1], [1, 0]]
    return jaw, turned
