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
    """Return all classes of the package with their bases, from the source text: nothing is imported."""
    text = "\n".join(path.read_text() for path in sorted((ROOT / "jaxgrasp").rglob("*.py")))
    return dict(re.findall(r"^class (\w+)\((.*)\):$", text, re.M))


def test_every_room_has_its_page():
    for room in ("jaxgrasp", *jaxgrasp._ROOMS):
        name = room if room == "jaxgrasp" else f"jaxgrasp.{room}"
        assert f".. room:: {name}\n" in (REFERENCE / f"{room}.md").read_text()


def test_pages_of_groups_list_public_names_of_their_room_once_each():
    for folder in sorted(path for path in REFERENCE.iterdir() if path.is_dir() and path.name != "command_line"):
        room = jaxgrasp if folder.name == "jaxgrasp" else getattr(jaxgrasp, folder.name)
        listed = []
        for page in sorted(folder.glob("*.md")):
            (names,) = re.findall(rf"^\.\. room:: {room.__name__}\n   :names:(.*?)^```", page.read_text(), re.M | re.S)
            listed += names.split()
            assert f"\n{folder.name}/{page.stem}\n" in (REFERENCE / f"{folder.name}.md").read_text()
        assert len(listed) == len(set(listed)) and set(listed) <= set(room.__all__)


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
