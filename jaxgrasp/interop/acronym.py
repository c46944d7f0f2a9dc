"""ACRONYM's files: poses of a Franka hand in the frame of an object's mesh, in HDF5.

``grasps/transforms`` (N, 4, 4) are of the gripper in the mesh's frame, at the scale of ``object/scale`` [m for one
unit]; it looks along its z axis and closes along x. ``object`` has ``file``, ``mass`` [kg], ``friction`` and ``com``,
the centre of mass, in the mesh's frame [m]; ``grasps/qualities/flex/object_in_gripper`` says which held in simulation.
Normals and forces there are none. How the object moved in simulation, its inertia, density and volume, and the
gripper's configuration are not needed; a warning names whatever else a file has. ``grasps/angles``,
joints of a hand that does not close any further, is ours.

Source: Eppner, Mousavian and Fox, ACRONYM, 2021; https://github.com/NVlabs/acronym.
"""

from pathlib import Path
from typing import Any

from jaxgrasp.interop.file_records import GraspPoses, warn_unused
from jaxgrasp.interop.grasp_fields import poses_of_fields
from jaxgrasp.validation.checked import checked
from jaxgrasp.validation.optional_library import hdf5_library

PLACES = {
    "transforms": "grasps/transforms",
    "angles": "grasps/angles",
    "mass": "object/mass",
    "friction": "object/friction",
    "center_of_mass": "object/com",
    "scale": "object/scale",
    "mesh": "object/file",
    "succeeded": "grasps/qualities/flex/object_in_gripper",
}

NOT_NEEDED = (
    *(
        f"grasps/qualities/flex/object_motion_during_{phase}"
        for phase in ("closing_angular", "closing_linear", "shaking_angular", "shaking_linear")
    ),
    "gripper/configuration",
    "gripper/type",
    "object/density",
    "object/inertia",
    "object/volume",
)
"""Arrays of the project's own files that say nothing about contacts at rest."""


@checked
def read_acronym(path: str | Path, *, keep_going: bool = False) -> GraspPoses:
    """Read the grasps of an ACRONYM file.

    Args:
        path: a ``.h5`` or ``.hdf5`` file.
        keep_going: leave bad grasps out and say what is wrong with them, instead of stopping at the first.

    Returns:
        Poses in the mesh's frame.

    Raises:
        ImportError: without h5py.
        ValueError: for a file that is none of ACRONYM's, naming what is wrong.
        OSError: for a file that cannot be read.
    """
    fields, names = _fields(path)
    warn_unused("ACRONYM", names, (*PLACES.values(), *NOT_NEEDED))
    return poses_of_fields(Path(path), fields, PLACES, keep_going)


def _fields(path: str | Path) -> tuple[dict[str, Any], list[str]]:
    """Return arrays by our names, and the names of all arrays that the file has."""
    h5py = hdf5_library()
    # h5py's own message for a missing file is five lines long.
    with open(path, "rb"):
        pass
    try:
        with h5py.File(path, "r") as file:
            names: list[str] = []
            file.visititems(lambda name, part: names.append(name) if isinstance(part, h5py.Dataset) else None)
            return {name: file[dataset][()] for name, dataset in PLACES.items() if dataset in file}, names
    except (OSError, KeyError, TypeError, ValueError, MemoryError) as error:
        raise ValueError(f"{path}: it cannot be read as HDF5: {error}") from None
