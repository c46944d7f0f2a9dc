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
    """The packages of each layer, the highest first, as the contract of import-linter has them."""
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]["contracts"]
    (layers,) = (contract["layers"] for contract in contracts if contract["type"] == "layers")
    return [[name.strip().removeprefix("jaxgrasp.") for name in re.split(r"[|:]", row)] for row in layers]


def imports() -> set[tuple[str, str]]:
    """Which package imports from which, directly."""
    graph = grimp.build_graph("jaxgrasp")
    packages = sorted(graph.find_children("jaxgrasp"))
    for package in packages:
        graph.squash_module(package)
    found = ((one, other) for one in packages for other in graph.find_modules_directly_imported_by(one))
    return {(one.split(".")[1], other.split(".")[1]) for one, other in found if other in packages and one != other}


def reduced(edges: set[tuple[str, str]]) -> set[tuple[str, str]]:
    """The edges without those that others imply: a picture that can be read."""

    def reaches(start: str, end: str, without: tuple[str, str]) -> bool:
        seen, ahead = set(), [start]
        while ahead:
            here = ahead.pop()
            following = [b for a, b in edges if a == here and (a, b) != without and b not in seen]
            if end in following:
                return True
            seen.update(following)
            ahead += following
        return False

    return {edge for edge in edges if not reaches(*edge, edge)}


def purpose(package: str) -> str:
    """The first line of a package's docstring."""
    text = ast.get_docstring(ast.parse((ROOT / "jaxgrasp" / package / "__init__.py").read_text())) or ""
    return text.splitlines()[0].rstrip(".")


def picture() -> str:
    """The picture in Mermaid, and what each package is for."""
    lines = ["```mermaid", "flowchart TD"]
    for number, row in enumerate(rows()):
        lines += [f'    subgraph row{number}[" "]', "        direction LR"]
        lines += [f"        {name}" for name in row] + ["    end"]
    lines += [f"    {one} --> {other}" for one, other in sorted(reduced(imports()))]
    lines += ["```", "", "| package | what it is for |", "|---|---|"]
    lines += [f"| `{name}` | {purpose(name)} |" for row in rows() for name in row]
    return "\n".join(lines) + "\n"


def page() -> str:
    """ARCHITECTURE with the picture of today."""
    return BLOCK.sub(lambda match: match[1] + picture() + match[2], PAGE.read_text())


if __name__ == "__main__":
    PAGE.write_text(page())
