"""Text of unknown origin, such as names in files, as a terminal may show it: one line, no control characters."""

LARGEST = 200
"""Characters of a value that are shown."""


def printable(text: object) -> str:
    """The text with everything escaped that a terminal would act on, line breaks too."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode("ascii") for c in str(text))


def shortened(value: object) -> str:
    """A value as Python writes it, in one line of at most some 200 characters."""
    text = printable(repr(value))
    return text if len(text) <= LARGEST else f"{text[:LARGEST]} ... ({len(text):,} characters)"


def printable_lines(text: object) -> str:
    """Like ``printable`` for a text of several lines, which stay lines."""
    return "\n".join(printable(line) for line in str(text).split("\n"))
