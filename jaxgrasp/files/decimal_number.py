"""Numbers in text files, as spreadsheets and other languages write them."""

import re

from jaxgrasp.files.printable import shortened

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
