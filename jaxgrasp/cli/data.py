"""The grasps that a command works on."""

from importlib.resources import files
from pathlib import Path
from typing import Protocol, runtime_checkable

from jaxgrasp.batch.remote_file import RemoteFile
from jaxgrasp.batch.sources import Adjustments, GraspSource, open_source
from jaxgrasp.cli.data_arguments import Data


@runtime_checkable
class Conventions(Protocol):
    """Arguments that say how the grasps of a file differ from the conventions."""

    @property
    def normals(self) -> str: ...

    @property
    def normalize(self) -> bool: ...


SHIPPED = "simulated_grips.npz"


def data_path(file: "Path | RemoteFile | None") -> "Path | RemoteFile":
    """Return ``file``, or the path of the grasps that ship with the package where it is None."""
    return file or Path(str(files("jaxgrasp") / "data" / SHIPPED))


def adjustments_of(arguments: Conventions) -> Adjustments:
    """Return the changes to normals that bring the file's grasps to the conventions."""
    return Adjustments(arguments.normals == "outward", normalize=arguments.normalize)


def opened(data: Data, adjustments: Adjustments) -> GraspSource:
    """Open the file of grasps that the arguments name, for a ``with`` block."""
    return open_source(data_path(data.file), adjustments)
