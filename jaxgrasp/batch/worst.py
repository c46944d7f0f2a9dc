"""Data to draw single problems: the extremes of an evaluation, and examples of grasps that fail."""

import math
from collections.abc import Iterable

import numpy as np

from jaxgrasp.batch.contact_sets import ContactSets
from jaxgrasp.batch.engine import MethodResult
from jaxgrasp.model.solution import is_balanced

WORST_CASES = 10


def worst_cases(
    sets: ContactSets, results: dict[str, MethodResult], price: np.ndarray, method: str, numbers: np.ndarray
) -> list[dict]:
    """Return the problems of highest positive price, worst first; ``numbers`` are those of the grasps in the input."""
    flat = price.ravel()
    order = np.argsort(-flat, kind="stable")[:WORST_CASES]
    chosen = order[flat[order] > 0]
    cases = cases_of(sets, results, method, chosen, numbers)
    return [case | {"price": float(flat[problem])} for case, problem in zip(cases, chosen, strict=True)]


def cases_of(
    sets: ContactSets,
    results: dict[str, MethodResult],
    method: str,
    problems: Iterable[int] | np.ndarray,
    numbers: np.ndarray,
) -> list[dict]:
    """Return the data of ``problems``, flat indices in ``(N, W)``, with the answers of ``method`` and its optimum.

    An answer is None where its method was not asked for, or has no forces that balance the wrench.
    """
    closed, optimum = results.get(method), results.get(f"{method}-optimum")
    cases = []
    for problem in problems:
        grasp, wrench = divmod(int(problem), sets.wrenches)
        contacts = slice(sets.offsets[grasp], sets.offsets[grasp + 1])
        cases.append(
            {
                "grasp": int(numbers[grasp]),
                "wrench_number": wrench,
                "method": method,
                "labels": {name: str(values[grasp]) for name, values in sets.labels.items()},
                "price": None,
                "margin": None if closed is None else finite_or_none(closed.margin[grasp, wrench]),
                "violation": None if closed is None else finite_or_none(closed.violation[grasp, wrench]),
                "points": sets.points[contacts].tolist(),
                "normals": sets.normals[contacts].tolist(),
                "friction": sets.friction[contacts].tolist(),
                "squeeze": sets.squeeze[contacts].tolist(),
                "wrench": sets.wrench[grasp, wrench].tolist(),
                "closed": _forces(closed, contacts, grasp, wrench),
                "optimum": _forces(optimum, contacts, grasp, wrench),
            }
        )
    return cases


def case_title(case: dict, several: bool = False) -> str:
    """Return a grasp's name, or its number if it has no name; with the number of its wrench if ``several``."""
    title = case["labels"].get("name") or f"grasp {case['grasp']}"
    return f"{title}, wrench {case['wrench_number']}" if several else title


def finite_or_none(value: float | np.floating) -> float | None:
    """Convert a number for JSON, which has no infinity: a finite float, or else None."""
    return float(value) if math.isfinite(value) else None


def _forces(result: MethodResult | None, contacts: slice, grasp: int, wrench: int) -> list | None:
    if result is None or not is_balanced(result.verdict[grasp, wrench]):
        return None
    return result.forces[contacts, wrench].tolist()
