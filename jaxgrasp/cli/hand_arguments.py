"""Arguments of ``jaxgrasp hand``."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import tyro


@dataclass(frozen=True)
class CheckHand:
    """List the joints, links, shapes and meshes of a hand's file that are used, left out or missing (needs `hands`)."""

    action: tyro.conf.Positional[Literal["check"]]
    """Action to take."""
    file: tyro.conf.Positional[Path]
    """The hand's URDF or MJCF."""
    wrist: str | None = None
    """Body that is the wrist; where not given, the last one that all joints hang on."""
