"""The directives ``command-line``, which shows the help of commands, and ``commands``, which lists them."""

import contextlib
import io
import os
import re
from pathlib import Path

import tyro
from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

from jaxgrasp.cli.main import REGISTRY, Command

WIDTH = "88"
NAMED = re.compile(r"^```\{command-line\} (.+)$", re.M)
GROUP = re.compile(r"\{([\w,-]+)\}$")


def help_of(command: tuple[str, ...]) -> str:
    """Return the text that ``jaxgrasp COMMAND --help`` prints."""
    text = io.StringIO()
    width = os.environ.get("COLUMNS")
    os.environ["COLUMNS"] = WIDTH
    try:
        with contextlib.redirect_stdout(text), contextlib.suppress(SystemExit):
            tyro.cli(Command, prog="jaxgrasp", args=[*command, "--help"], registry=REGISTRY)
    finally:
        os.environ.pop("COLUMNS")
        if width is not None:
            os.environ["COLUMNS"] = width
    return "\n".join(line.rstrip() for line in text.getvalue().strip().splitlines())


def commands(above: tuple[str, ...] = ()) -> list[tuple[str, ...]]:
    """Return every command that can run, and the groups of commands."""
    usage = help_of(above).split("\n\n")[0].replace("\n", " ")
    group = GROUP.search(usage) if "subcommands" in help_of(above) else None
    found = [above] if above else []
    for name in group[1].split(",") if group else []:
        found += commands((*above, name))
    return found


class CommandLine(SphinxDirective):
    """Section for each named command and its subcommands, or for the commands that no other page names."""

    optional_arguments = 1
    final_argument_whitespace = True

    def run(self) -> list[nodes.Node]:
        """Return consecutive sections, so that each has an entry in the page's contents."""
        names = self.arguments[0].split() if self.arguments else unlisted()
        sections: list[nodes.Node] = []
        for command in commands():
            if command[0] not in names:
                continue
            title = " ".join(("jaxgrasp", *command))
            section = nodes.section(ids=[title.replace(" ", "-")], names=[title])
            section += nodes.title(text=title)
            section += nodes.literal_block(help_of(command), help_of(command), language="text", classes=["help"])
            sections.append(section)
        return sections


class Commands(SphinxDirective):
    """List of all commands, each with a link and the first sentence of its help."""

    def run(self) -> list[nodes.Node]:
        """Return one bulleted list."""
        pages = {name: page for page, names in listed().items() for name in names}
        listing = nodes.bullet_list()
        for command in commands():
            title = " ".join(("jaxgrasp", *command))
            page = f"command_line/{pages[command[0]]}.html" if command[0] in pages else ""
            link = nodes.reference("", "", nodes.literal(text=title), refuri=f"{page}#{title.replace(' ', '-')}")
            # Of a text with `code` in it, every second part is code.
            parts = enumerate(f": {first_sentence(command)}".split("`"))
            words = [nodes.literal(text=part) if k % 2 else nodes.Text(part) for k, part in parts]
            listing += nodes.list_item("", nodes.paragraph("", "", link, *words))
        return [listing]


def first_sentence(command: tuple[str, ...]) -> str:
    """Return the first sentence of a command's help."""
    about = help_of(command).split("\n\n")[1]
    return re.split(r"(?<=[.!?])\s+(?=[A-Z`])", " ".join(about.split()))[0]


def listed() -> dict[str, list[str]]:
    """Return the commands that each page of the folder ``command_line`` names."""
    folder = Path(__file__).resolve().parent.parent / "reference" / "command_line"
    found = {page.stem: NAMED.search(page.read_text()) for page in folder.glob("*.md")}
    return {page: names[1].split() for page, names in found.items() if names is not None}


def unlisted() -> list[str]:
    """Return the commands that no page of the folder names."""
    named = {name for names in listed().values() for name in names}
    return [command[0] for command in commands() if command[0] not in named]


def setup(app: Sphinx) -> dict:
    """Register the directives."""
    app.add_directive("command-line", CommandLine)
    app.add_directive("commands", Commands)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
