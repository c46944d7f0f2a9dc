"""Arguments of ``jaxgrasp hand``."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import tyro


@dataclass(frozen=True)
class CheckHand:
    """Say which joints, links, shapes and meshes of a hand's file are used, left out or missing (needs `hands`)."""

    action: tyro.conf.Positional[Literal["check"]]
    """What to do with it."""
    file: tyro.conf.Positional[Path]
    """The hand's URDF or MJCF."""
    wrist: str | None = None
    """Body that is the wrist; where not given, the last one that all joints hang on."""
