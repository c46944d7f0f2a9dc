"""Text of unknown origin, such as names in files, as a terminal may show it: one line, no control characters."""

LARGEST = 200
"""Characters of a value that are shown."""
LONGEST_MESSAGE = 1000
"""Characters of a message that are shown: its place comes first, what was expected last."""


def printable(text: object) -> str:
    """The text with everything escaped that a terminal would act on, line breaks too."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode("ascii") for c in str(text))


def shortened(value: object) -> str:
    """A value as Python writes it, in one line of at most some 200 characters."""
    text = printable(repr(value))
    return text if len(text) <= LARGEST else f"{text[:LARGEST]} ... ({len(text):,} characters)"


def message_line(text: object) -> str:
    """A message in one line, whose middle is left out where a file's own text made it longer than anyone reads."""
    line = printable(text)
    if len(line) <= LONGEST_MESSAGE:
        return line
    half = LONGEST_MESSAGE // 2
    return f"{line[:half]} ... ({len(line) - 2 * half:,} characters left out) ... {line[-half:]}"


def printable_lines(text: object) -> str:
    """Like ``printable`` for a text of several lines, which stay lines."""
    return "\n".join(printable(line) for line in str(text).split("\n"))
