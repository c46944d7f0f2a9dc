"""Examples in docstrings run, each by itself, and print what stands below them."""

import ast
import doctest
from collections.abc import Iterator
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parent.parent.parent / "jaxgrasp"
COMPILED = {"force", "hand", "psychophysics"}
"""Rooms whose examples take seconds to compile, or to load."""


def examples() -> Iterator:
    """Yield a test for each docstring that has an example, named by module and object."""
    for path in sorted(PACKAGE.rglob("*.py")):
        text = path.read_text()
        if ">>>" not in text:
            continue
        room = path.relative_to(PACKAGE).parts[0]
        marks = (pytest.mark.slow, pytest.mark.always) if room in COMPILED else ()
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, (ast.FunctionDef, ast.ClassDef, ast.Module)) and ">>>" in (
                ast.get_docstring(node) or ""
            ):
                name = f"{path.stem}.{getattr(node, 'name', '')}"
                docstring_test = doctest.DocTestParser().get_doctest(ast.get_docstring(node), {}, name, str(path), 0)
                yield pytest.param(docstring_test, marks=marks, id=name)


@pytest.mark.parametrize("example", list(examples()))
def test_it_prints_what_stands_below(example):
    output_lines: list[str] = []
    outcome = doctest.DocTestRunner().run(example, out=output_lines.append)
    assert outcome.attempted and not outcome.failed, "".join(output_lines)


def test_there_are_examples():
    assert len(list(examples())) >= 10
