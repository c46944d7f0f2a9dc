"""ARCHITECTURE's picture of the packages, from the code: who imports whom, in the rows that the layers allow.

    python -m benchmarks.architecture

The picture stands between ``<!-- packages -->`` and ``<!-- end packages -->``; a test holds it to what this writes.
"""

import ast
import re
import tomllib
from pathlib import Path

import grimp

ROOT = Path(__file__).parent.parent
PAGE = ROOT / "ARCHITECTURE.md"
BLOCK = re.compile(r"(<!-- packages -->\n).*?(<!-- end packages -->)", re.DOTALL)


def rows() -> list[list[str]]:
    """Read the packages of each layer from the contract of import-linter, the highest first."""
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]["contracts"]
    (layers,) = (contract["layers"] for contract in contracts if contract["type"] == "layers")
    return [[name.strip().removeprefix("jaxgrasp.") for name in re.split(r"[|:]", row)] for row in layers]


def imports() -> set[tuple[str, str]]:
    """Return the direct imports between packages, as pairs (importer, imported)."""
    graph = grimp.build_graph("jaxgrasp")
    packages = sorted(graph.find_children("jaxgrasp"))
    for package in packages:
        graph.squash_module(package)
    edges = (
        (importer, imported) for importer in packages for imported in graph.find_modules_directly_imported_by(importer)
    )
    return {
        (importer.split(".")[1], imported.split(".")[1])
        for importer, imported in edges
        if imported in packages and importer != imported
    }


def reduced(edges: set[tuple[str, str]]) -> set[tuple[str, str]]:
    """Remove the edges that others imply, so that the picture can be read."""

    def reaches(start: str, end: str, without: tuple[str, str]) -> bool:
        visited, ahead = set(), [start]
        while ahead:
            package = ahead.pop()
            following = [b for a, b in edges if a == package and (a, b) != without and b not in visited]
            if end in following:
                return True
            visited.update(following)
            ahead += following
        return False

    return {edge for edge in edges if not reaches(*edge, edge)}


def purpose(package: str) -> str:
    """Return the first line of a package's docstring."""
    text = ast.get_docstring(ast.parse((ROOT / "jaxgrasp" / package / "__init__.py").read_text())) or ""
    return text.splitlines()[0].rstrip(".")


def title(package: str) -> str:
    """Return a package's name for the table: a public package links to its page of the reference."""
    page = f"docs/reference/{package}.md"
    return f"[`{package}`]({page})" if (ROOT / page).exists() else f"`{package}`"


def picture() -> str:
    """Return the picture in Mermaid, and the table of the packages with the purpose of each."""
    lines = ["```mermaid", "flowchart TD"]
    for number, row in enumerate(rows()):
        lines += [f'    subgraph row{number}[" "]', "        direction LR"]
        lines += [f"        {name}" for name in row] + ["    end"]
    lines += [f"    {importer} --> {imported}" for importer, imported in sorted(reduced(imports()))]
    lines += ["```", "", "| package | purpose |", "|---|---|"]
    lines += [f"| {title(name)} | {purpose(name)} |" for row in rows() for name in row]
    return "\n".join(lines) + "\n"


def page() -> str:
    """Return ARCHITECTURE with the current picture."""
    return BLOCK.sub(lambda match: match[1] + picture() + match[2], PAGE.read_text())


if __name__ == "__main__":
    PAGE.write_text(page())
