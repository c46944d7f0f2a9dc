"""The commands of ``jaxgrasp scene`` and their arguments."""

from dataclasses import dataclass
from typing import Annotated

import tyro


@dataclass(frozen=True)
class Check:
    """Check a scene: errors name the table and the key, before anything compiles."""

    scene: tyro.conf.Positional[str] = "cylinder"
    """TOML file of the scene, or the name of a ready one."""


@dataclass(frozen=True)
class ReadyScenes:
    """List the scenes that come with the package."""


@dataclass(frozen=True)
class SceneCommand:
    """Scenes in TOML files, for `jaxgrasp glove run` and `jaxgrasp grip --scene`."""

    command: tyro.conf.OmitSubcommandPrefixes[
        tyro.conf.OmitArgPrefixes[
            Annotated[Check, tyro.conf.subcommand("check")] | Annotated[ReadyScenes, tyro.conf.subcommand("list")]
        ]
    ]
