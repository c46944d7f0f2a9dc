"""ARCHITECTURE's picture is that of the code, and the files that it names exist."""

import re

from benchmarks import architecture


def test_the_picture_is_that_of_the_code():
    assert architecture.page() == architecture.PAGE.read_text()


def test_every_package_stands_in_a_row():
    folders = {path.parent.name for path in (architecture.ROOT / "jaxgrasp").glob("*/__init__.py")}
    assert folders - {"data"} == {name for row in architecture.rows() for name in row}


def test_the_files_that_it_names_exist():
    named = re.findall(r"`([\w/]+\.py)`", architecture.PAGE.read_text())
    assert len(named) > 20
    for name in named:
        assert list((architecture.ROOT / "jaxgrasp").rglob(name)), name
