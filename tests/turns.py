"""Cases of a law that take turns with the long tests."""

from collections.abc import Collection, Iterable
from typing import Any

import pytest


def later(*cases: Any) -> list[Any]:
    """Mark cases of a parametrized test as long ones; with several arguments, each case is a tuple."""
    return [pytest.param(*(case if isinstance(case, tuple) else (case,)), marks=pytest.mark.slow) for case in cases]


def in_turns(cases: Iterable[Any], quick: Collection[Any]) -> list[Any]:
    """Return all cases in their order: the ``quick`` ones run always, the others are ``later``."""
    return [case if case in quick else later(case)[0] for case in cases]
