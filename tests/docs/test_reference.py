"""The reference leaves nothing out: every room, every code that answers come with, every error."""

import re
from functools import cache
from pathlib import Path

import jaxgrasp

ROOT = Path(__file__).parent.parent.parent
REFERENCE = ROOT / "docs" / "reference"
INNER = {"Kind", "Phase", "PsychometricShape"}
"""Enumerations that name no outcome: kinds of frames, of pages, of curves."""


@cache
def classes() -> dict[str, str]:
    """All classes of the package and what they derive from, by their text: nothing is imported."""
    text = "\n".join(path.read_text() for path in sorted((ROOT / "jaxgrasp").rglob("*.py")))
    return dict(re.findall(r"^class (\w+)\((.*)\):$", text, re.M))


def test_every_room_has_its_page():
    for room in ("jaxgrasp", *jaxgrasp._ROOMS):
        name = room if room == "jaxgrasp" else f"jaxgrasp.{room}"
        assert f".. room:: {name}\n" in (REFERENCE / f"{room}.md").read_text()


def test_every_code_has_its_table():
    page = (REFERENCE / "outcomes.md").read_text()
    listed = {name for _, name in re.findall(r"^```\{outcomes\} (\S+) (\S+)$", page, re.M)}
    assert listed == {name for name, base in classes().items() if base.endswith("Enum")} - INNER


def test_every_error_has_its_row():
    page = (REFERENCE / "outcomes.md").read_text()
    errors = {name for name, base in classes().items() if base.endswith("Error")}
    assert len(errors) > 5
    for error in errors:
        assert re.search(rf"^\| `[\w.]*\b{error}`", page, re.M), error
