"""The directive ``command-line``: the help of every command, as the command itself gives it."""

import contextlib
import io
import os
import re

import tyro
from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

from jaxgrasp.cli.main import Command
from jaxgrasp.cli.optional_arguments import REGISTRY

WIDTH = "88"
GROUP = re.compile(r"\{([\w,-]+)\}$")


def help_of(command: tuple[str, ...]) -> str:
    """What ``jaxgrasp COMMAND --help`` prints."""
    said = io.StringIO()
    width = os.environ.get("COLUMNS")
    os.environ["COLUMNS"] = WIDTH
    try:
        with contextlib.redirect_stdout(said), contextlib.suppress(SystemExit):
            tyro.cli(Command, prog="jaxgrasp", args=[*command, "--help"], registry=REGISTRY)
    finally:
        os.environ.pop("COLUMNS")
        if width is not None:
            os.environ["COLUMNS"] = width
    return "\n".join(line.rstrip() for line in said.getvalue().strip().splitlines())


def commands(above: tuple[str, ...] = ()) -> list[tuple[str, ...]]:
    """Every command that runs something, and the groups that hold them."""
    usage = help_of(above).split("\n\n")[0].replace("\n", " ")
    group = GROUP.search(usage) if "subcommands" in help_of(above) else None
    found = [above] if above else []
    for name in group[1].split(",") if group else []:
        found += commands((*above, name))
    return found


class CommandLine(SphinxDirective):
    """A section for each command."""

    def run(self) -> list[nodes.Node]:
        """Sections one below the other, so that each has an entry in the page's contents."""
        sections: list[nodes.Node] = []
        for command in commands():
            title = " ".join(("jaxgrasp", *command))
            section = nodes.section(ids=[title.replace(" ", "-")], names=[title])
            section += nodes.title(text=title)
            section += nodes.literal_block(help_of(command), help_of(command), language="text", classes=["help"])
            sections.append(section)
        return sections


def setup(app: Sphinx) -> dict:
    """Enter the directive."""
    app.add_directive("command-line", CommandLine)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
