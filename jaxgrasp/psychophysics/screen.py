"""Texts that a person reads at once."""

LINES, CHARACTERS = 20, 100
"""Size of a screen, in lines and in characters of a line."""


def check_screen(name: str, text: str) -> None:
    """Raise ValueError for a text that a person would have to scroll."""
    lines = text.split("\n")
    longest = max(map(len, lines))
    if len(lines) > LINES or longest > CHARACTERS:
        raise ValueError(
            f"{name} has {len(lines)} lines of up to {longest} characters: expected one screen, {LINES} lines of up to "
            f"{CHARACTERS} characters"
        )
