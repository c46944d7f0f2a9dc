"""Checks of numbers in files of unknown origin: numbers as text, and as values of JSON and TOML."""

import re
from typing import Any

from jaxgrasp.files.printable import shortened

HUGE = 1e300
"""Upper limit of every quantity; whole numbers far above it do not fit into a float."""
NUMBER = re.compile(r"[+-]?((\d+\.?\d*|\.\d+)(e[+-]?\d+)?|nan|inf(inity)?)", re.ASCII | re.IGNORECASE)
"""Pattern of a number; Python's own reading would take 1_0 for ten, and digits of every script."""


def decimal_number(text: str) -> float:
    """Convert text to a number; spaces and tabs around it do not count.

    Raises:
        ValueError: if the text is not a number; the message begins with "is", to follow the name of the place.
    """
    if not NUMBER.fullmatch(text.strip(" \t")):
        raise ValueError(f"is {shortened(text)}: expected a number")
    return float(text)


def is_number(value: Any, below: float = HUGE) -> bool:
    """Check that a value is an int or a float of size below ``below``; bools and NaN are rejected."""
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < below
