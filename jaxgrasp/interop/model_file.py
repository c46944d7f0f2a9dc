"""Parts that readers of models' files share: XML that is bounded before it is read, and the record of parts left out.

The size and the depth of XML of unknown origin are bounded before a tree of it is built. A part that a reader could not
use is named with the reason: none is dropped in silence.
"""

from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

from jaxgrasp.files.printable import printable, shortened

MOST_BYTES = 2**28
"""Largest file that is read: vertices of meshes can stand in an MJCF file as text."""
DEEPEST = 200
"""Deepest nesting of elements that is read; Python writes a tree by recursion, and stops at about 1,000."""


class _BoundedBuilder(ElementTree.TreeBuilder):
    """Tree builder that stops at elements nested too deeply, and at a document type."""

    def __init__(self) -> None:
        super().__init__()
        self.depth = 0

    def start(self, tag: str, attrs: dict[str, str]) -> ElementTree.Element:
        """Open an element."""
        self.depth += 1
        if self.depth > DEEPEST:
            raise ValueError(
                f"element <{printable(tag)[:40]}> is nested {self.depth} deep: expected a depth of at most {DEEPEST}"
            )
        return super().start(tag, attrs)

    def end(self, tag: str) -> ElementTree.Element:
        """Close an element."""
        self.depth -= 1
        return super().end(tag)

    def doctype(self, name: str, pubid: str | None, system: str | None) -> None:
        """Refuse a document type: parsers differ in what its entities hide."""
        raise ValueError(f"it has a document type, <!DOCTYPE {printable(name)[:40]} ...>: expected XML without")


def read_xml(path: Path, expected: str) -> ElementTree.Element:
    """Return the root element of an XML file.

    Args:
        path: of the file.
        expected: kind of the file, for messages, such as ``a URDF file``.

    Raises:
        ValueError: for a path that is no regular file, a file of more than 256 MiB, and text that is no XML, is nested
            more than 200 deep or has a document type.
        OSError: for a file that cannot be read.
    """
    if not path.is_file():
        raise ValueError(f"path is {shortened(str(path))}: expected {expected}, but there is none")
    size = path.stat().st_size
    if size > MOST_BYTES:
        raise ValueError(f"path is {str(path)!r}: it has {size} bytes: expected {MOST_BYTES} at most")
    parser = ElementTree.XMLParser(target=_BoundedBuilder())
    text = path.read_bytes()
    try:
        parser.feed(text)
        root = parser.close()
    except ElementTree.ParseError as error:
        hint = f"; {how_to_expand(path)}" if b"<xacro:" in text else ""
        raise ValueError(f"path is {str(path)!r}: expected {expected}, but it is not XML: {error}{hint}") from None
    except (ValueError, LookupError) as error:  # bounds of the builder, and encodings that expat does not know
        raise ValueError(f"path is {str(path)!r}: expected {expected}: {error}") from None
    assert isinstance(root, ElementTree.Element)
    return root


def how_to_expand(path: Path) -> str:
    """Return the advice for a file with macros of ROS."""
    target = path.name.removesuffix(".xacro").removesuffix(".urdf") + ".urdf"
    return f"a xacro has to be expanded first: xacro {path.name} > {target}"


class LeftOut(NamedTuple):
    """A part of a file that is not in the Hand, or not as the file has it."""

    part: str
    """Kind and name of the part, such as ``geom 'shell' of body 'palm'``."""
    why: str
    missing: bool = False
    """True for a shape whose file is not there or which cannot touch: readers stop there unless ``keep_going``."""

    def __str__(self) -> str:
        return f"{self.part}: {self.why}"
