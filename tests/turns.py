"""Cases of a law that take turns with the long tests."""

from collections.abc import Iterable
from typing import Any

import pytest


def later(*cases: Any) -> Iterable[Any]:
    """These cases of a parametrized test among the long ones; of several arguments, each case is a tuple."""
    return [pytest.param(*(case if isinstance(case, tuple) else (case,)), marks=pytest.mark.slow) for case in cases]
