"""The directives ``room`` and ``names``: public names of a module, from its ``__all__``.

``room`` writes each name's docstring, ``names`` a table with a line for each.
"""

import ast
import inspect
import re
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import ClassVar

from docutils import nodes
from docutils.statemachine import StringList
from prose_docstrings import to_restructured_text
from sphinx.application import Sphinx
from sphinx.pycode import ModuleAnalyzer
from sphinx.util.docutils import SphinxDirective

REFERENCE = Path(__file__).resolve().parent.parent / "reference"
MEMBERS = "   :members:\n   :undoc-members:\n"


def entry(room: str, name: str, thing) -> str:
    """Return the directive of autodoc that writes a name's entry."""
    if inspect.isclass(thing):
        return f".. autoclass:: {room}.{name}\n{MEMBERS}"
    if inspect.isroutine(thing) or callable(thing):
        return f".. autofunction:: {room}.{name}\n"
    home = home_of(room, name)
    documented = ModuleAnalyzer.for_module(home).find_attr_docs().get(("", name), [])
    lines = [f"   {line}" for line in to_restructured_text(list(documented))]
    return "\n".join([f".. py:data:: {name}", f"   :module: {room}", "", *lines, ""])


def home_of(room: str, name: str) -> str:
    """Return the module that defines a name of a room: a constant does not store it."""
    tree = ast.parse(inspect.getsource(import_module(room)))
    imports = [node for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)]
    (home,) = [str(node.module) for node in imports if name in {alias.name for alias in node.names}]
    return home


class Room(SphinxDirective):
    """Entries of ``.. room:: jaxgrasp.hand``: of the names in ``:names:``, or of those that no other page lists."""

    required_arguments = 1
    option_spec: ClassVar = {"names": str.split}

    def run(self) -> list[nodes.Node]:
        """Return the entries in the order of ``:names:``, or in alphabetical order."""
        room = self.arguments[0]
        module = import_module(room)
        names = self.options.get("names")
        if names is None:
            listed = listed_names(room)
            names = [name for name in sorted_names(module) if name not in listed]
        text = "\n".join(entry(room, name, getattr(module, name)) for name in names)
        self.env.note_dependency(module.__file__)
        holder = nodes.container()
        self.state.nested_parse(StringList(text.splitlines(), source="room"), self.content_offset, holder)
        return holder.children


class Names(SphinxDirective):
    """Table of ``.. names:: jaxgrasp.hand``: every public name with a link and its docstring's first sentence."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        """Return the table in alphabetical order."""
        room = self.arguments[0]
        module = import_module(room)
        lines = [".. list-table::", "   :class: names", "   :widths: 30 70", ""]
        for name in sorted_names(module):
            (sentence,) = to_restructured_text([first_sentence(room, name, getattr(module, name))])
            lines += [f"   * - :py:obj:`{name} <{room}.{name}>`", f"     - {sentence}"]
        self.env.note_dependency(module.__file__)
        holder = nodes.container()
        self.state.nested_parse(StringList(lines, source="names"), self.content_offset, holder)
        return holder.children


def first_sentence(room: str, name: str, thing) -> str:
    """Return the first sentence of a name's docstring, in one line."""
    is_constant = not (inspect.isclass(thing) or callable(thing))
    lines = ModuleAnalyzer.for_module(home_of(room, name)).find_attr_docs().get(("", name), []) if is_constant else None
    text = inspect.cleandoc("\n".join(lines)) if lines is not None else inspect.getdoc(thing) or ""
    paragraph = " ".join(text.split("\n\n")[0].split())
    return re.split(r"(?<=[.!?])\s+(?=[A-Z`])", paragraph)[0]


def listed_names(room: str) -> set[str]:
    """Return the names that pages of a group list, those in the folder beside the room's page."""
    pages = (REFERENCE / room.rpartition(".")[2]).glob("*.md")
    fields = [re.search(rf"^\.\. room:: {room}\n   :names:(.*?)^```", page.read_text(), re.M | re.S) for page in pages]
    return {name for field in fields if field is not None for name in field[1].split()}


def sorted_names(module: ModuleType) -> list[str]:
    """Return a room's public names in alphabetical order, capitals among the rest."""
    return sorted(public_names(module), key=str.lower)


def public_names(module: ModuleType) -> list[str]:
    """Return the public names of a module, without its public packages."""
    return [name for name in module.__all__ if not isinstance(getattr(module, name), ModuleType)]


def setup(app: Sphinx) -> dict:
    """Register the directives."""
    app.add_directive("room", Room)
    app.add_directive("names", Names)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
