"""Parts of a file that a reader of hands could not use, with reasons: no part is dropped in silence."""

from typing import NamedTuple


class LeftOut(NamedTuple):
    """A part of a file that is not in the Hand, or not as the file has it."""

    part: str
    """Kind and name of the part, such as ``geom 'shell' of body 'palm'``."""
    why: str
    missing: bool = False
    """True for a shape whose file is not there or which cannot touch: readers stop there unless ``keep_going``."""

    def __str__(self) -> str:
        return f"{self.part}: {self.why}"
