"""The directive ``outcomes``: a table of an enumeration's members with their advice or docstrings."""

from enum import Enum
from importlib import import_module

from docutils import nodes
from docutils.statemachine import StringList
from sphinx.application import Sphinx
from sphinx.pycode import ModuleAnalyzer
from sphinx.util.docutils import SphinxDirective


def meaning(member: Enum) -> str:
    """Return a member's ``advice``, after its ``title`` if it has one, or else the docstring below it."""
    advice = getattr(member, "advice", "")
    if advice:
        title = getattr(member, "title", "")
        return f"*{title}*. {advice}" if title else advice
    kind = type(member)
    documented = ModuleAnalyzer.for_module(kind.__module__).find_attr_docs()
    return " ".join(documented.get((kind.__name__, member.name), [])).strip() or member.name.lower().replace("_", " ")


class Outcomes(SphinxDirective):
    """Table of ``{outcomes} jaxgrasp.model.solution Verdict``."""

    required_arguments = 2

    def run(self) -> list[nodes.Node]:
        """Return code, name and meaning of each member, as a table in Markdown."""
        module, name = self.arguments
        rows = [
            f"| `{member.value}` | `{member.name}` | {meaning(member)} |"
            for member in getattr(import_module(module), name)
        ]
        holder = nodes.container()
        lines = [f"| code | `{name}` | what it means, and what to do |", "|---|---|---|", *rows]
        self.state.nested_parse(StringList(lines, source=name), self.content_offset, holder)
        return holder.children


def setup(app: Sphinx) -> dict:
    """Register the directive."""
    app.add_directive("outcomes", Outcomes)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
