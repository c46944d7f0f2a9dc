"""Docstrings as reStructuredText: they are prose with ``code`` in it, in which |f| is a length and * multiplies."""

import re

from sphinx.application import Sphinx

CODE = re.compile(r"(``.+?``)")
REFERENCE = re.compile(r"\[`(jaxgrasp[\w.]*)`\]\[\]")
EXAMPLE = re.compile(r"^\s*>>>")


def _prose(text: str) -> str:
    """Return a line's words, with references linked and other marks of reStructuredText escaped."""
    parts = REFERENCE.split(text)
    words = [re.sub(r"([\\|*`])|(?<=\w)_(?!\w)", lambda mark: f"\\{mark[0]}", part) for part in parts[::2]]
    links = [f":py:obj:`{name}`" for name in parts[1::2]]
    return "".join(word + link for word, link in zip(words, [*links, ""], strict=True))


def to_restructured_text(lines: list[str]) -> list[str]:
    """Return a docstring's lines with all text that is not markup escaped; examples are unchanged."""
    found, in_example = [], False
    for line in lines:
        in_example = bool(EXAMPLE.match(line)) or (in_example and bool(line.strip()))
        parts = [line] if in_example else CODE.split(line)
        found.append("".join(part if in_example or part.startswith("``") else _prose(part) for part in parts))
    return found


def _process(app, what, name, thing, options, lines: list[str]) -> None:
    lines[:] = to_restructured_text(lines)


def setup(app: Sphinx) -> dict:
    """Register before napoleon, whose own marks must stay."""
    app.connect("autodoc-process-docstring", _process, priority=100)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
