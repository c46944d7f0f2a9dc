"""The problems where a closed form deceives most, with all that is needed to draw them."""

import numpy as np

from jaxgrasp.batch.contact_sets import ContactSets
from jaxgrasp.batch.engine import MethodResult

KEPT = 10


def worst_cases(
    sets: ContactSets,
    closed: MethodResult,
    optimum: MethodResult,
    price: np.ndarray,
    method: str,
    numbers: np.ndarray,
) -> list[dict]:
    """The problems of highest price, worst first; only those that have one. ``numbers``: of the grasps in the input."""
    flat = price.ravel()
    order = np.argsort(-flat, kind="stable")[:KEPT]
    cases = []
    for problem in order[flat[order] > 0]:
        grasp, wrench = divmod(int(problem), sets.wrenches)
        own = slice(sets.offsets[grasp], sets.offsets[grasp + 1])
        cases.append(
            {
                "grasp": int(numbers[grasp]),
                "wrench_number": wrench,
                "method": method,
                "labels": {name: str(values[grasp]) for name, values in sets.labels.items()},
                "price": float(price[grasp, wrench]),
                "margin": float(closed.margin[grasp, wrench]),
                "violation": float(closed.violation[grasp, wrench]),
                "points": sets.points[own].tolist(),
                "normals": sets.normals[own].tolist(),
                "friction": sets.friction[own].tolist(),
                "squeeze": sets.squeeze[own].tolist(),
                "wrench": sets.wrench[grasp, wrench].tolist(),
                "closed": closed.forces[own, wrench].tolist(),
                "optimum": optimum.forces[own, wrench].tolist(),
            }
        )
    return cases
