"""Numbers in files from anywhere: as text, and as JSON and TOML have them."""

import re
from typing import Any

from jaxgrasp.files.printable import shortened

HUGE = 1e300
"""No quantity is this large, and whole numbers beyond are too large to be a float."""
NUMBER = re.compile(r"[+-]?((\d+\.?\d*|\.\d+)(e[+-]?\d+)?|nan|inf(inity)?)", re.ASCII | re.IGNORECASE)
"""What counts as a number; Python's own reading would take 1_0 for ten, and digits of every script."""


def decimal_number(text: str) -> float:
    """The number that a text is.

    Raises:
        ValueError: for a text that is none; the message begins with "is", to follow what names the place.
    """
    if not NUMBER.fullmatch(text.strip(" \t")):
        raise ValueError(f"is {shortened(text)}: expected a number")
    return float(text)


def is_number(value: Any, below: float = HUGE) -> bool:
    """Whether a value is a number, smaller than ``below`` in size; True and False are none, nor is NaN."""
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < below
