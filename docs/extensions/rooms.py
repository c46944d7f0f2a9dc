"""The directive ``room``: every public name of a module, as its ``__all__`` has them, each with its docstring."""

import ast
import inspect
from importlib import import_module
from types import ModuleType

from docutils import nodes
from docutils.statemachine import StringList
from prose_docstrings import to_restructured_text
from sphinx.application import Sphinx
from sphinx.pycode import ModuleAnalyzer
from sphinx.util.docutils import SphinxDirective

MEMBERS = "   :members:\n   :undoc-members:\n"


def entry(room: str, name: str, thing) -> str:
    """The directive of autodoc that writes a name's page."""
    if inspect.isclass(thing):
        return f".. autoclass:: {room}.{name}\n{MEMBERS}"
    if inspect.isroutine(thing) or callable(thing):
        return f".. autofunction:: {room}.{name}\n"
    home = home_of(room, name)
    documented = ModuleAnalyzer.for_module(home).find_attr_docs().get(("", name), [])
    lines = [f"   {line}" for line in to_restructured_text(list(documented))]
    return "\n".join([f".. py:data:: {name}", f"   :module: {room}", "", *lines, ""])


def home_of(room: str, name: str) -> str:
    """The module that a name of a room comes from: a constant itself does not know."""
    tree = ast.parse(inspect.getsource(import_module(room)))
    imports = [node for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)]
    (home,) = [str(node.module) for node in imports if name in {alias.name for alias in node.names}]
    return home


class Room(SphinxDirective):
    """``{room} jaxgrasp.hand``."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        """Entries in alphabetical order."""
        room = self.arguments[0]
        module = import_module(room)
        things = {name: getattr(module, name) for name in sorted(public_names(module), key=str.lower)}
        text = "\n".join(entry(room, name, thing) for name, thing in things.items())
        self.env.note_dependency(module.__file__)
        holder = nodes.container()
        self.state.nested_parse(StringList(text.splitlines(), source="room"), self.content_offset, holder)
        return holder.children


def public_names(module: ModuleType) -> list[str]:
    """The names of a module's door, without the rooms behind it."""
    return [name for name in module.__all__ if not isinstance(getattr(module, name), ModuleType)]


def setup(app: Sphinx) -> dict:
    """Enter the directive."""
    app.add_directive("room", Room)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
