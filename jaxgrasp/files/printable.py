"""Text of unknown origin, such as names in files, as a terminal may show it: one line, no control characters."""

LARGEST = 200
"""Characters of a value that are shown."""
LONGEST_MESSAGE = 1000
"""Characters of a message that are shown: its place comes first, what was expected last."""


def printable(text: object) -> str:
    """Escape every character that a terminal would act on, line breaks included."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode("ascii") for c in str(text))


def shortened(value: object) -> str:
    """Format a value by ``repr`` in a single line, cut after 200 characters with a note of the full length."""
    text = printable(repr(value))
    return text if len(text) <= LARGEST else f"{text[:LARGEST]} ... ({len(text):,} characters)"


def message_line(text: object) -> str:
    """Format a message in a single line; leave out the middle if it is longer than 1,000 characters."""
    line = printable(text)
    if len(line) <= LONGEST_MESSAGE:
        return line
    half = LONGEST_MESSAGE // 2
    return f"{line[:half]} ... ({len(line) - 2 * half:,} characters left out) ... {line[-half:]}"


def printable_lines(text: object) -> str:
    """Escape each line of a text as ``printable`` does, and keep the line breaks."""
    return "\n".join(printable(line) for line in str(text).split("\n"))
