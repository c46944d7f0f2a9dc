"""The grasps that a command works on."""

from contextlib import AbstractContextManager, nullcontext
from importlib.resources import files
from pathlib import Path

from jaxgrasp.batch.sources import Adjustments, GraspSource, open_source
from jaxgrasp.cli.data_arguments import Data

SHIPPED = "simulated_grips.npz"


def data_path(data: Data) -> Path:
    """The file asked for, or the one that ships with the package."""
    return data.file or Path(str(files("jaxgrasp") / "data" / SHIPPED))


def opened(data: Data, adjustments: Adjustments) -> AbstractContextManager[GraspSource]:
    source = open_source(data_path(data), adjustments)
    return source if isinstance(source, AbstractContextManager) else nullcontext(source)
