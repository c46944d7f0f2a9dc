"""ACRONYM's files: poses of a Franka hand in the frame of an object's mesh, in HDF5.

``grasps/transforms`` (N, 4, 4) are of the gripper in the mesh's frame, at the scale of ``object/scale`` [m for one
unit]; it looks along its z axis and closes along x. ``object`` has ``file``, ``mass`` [kg], ``friction`` and ``com``,
the centre of mass, in the mesh's frame [m]; ``grasps/qualities/flex/object_in_gripper`` says which held in simulation.
Normals and forces there are none. ``grasps/angles``, joints of a hand that does not close any further, is ours.

Source: Eppner, Mousavian and Fox, ACRONYM, 2021; https://github.com/NVlabs/acronym.
"""

from pathlib import Path
from typing import Any

from jaxgrasp.interop.grasp_fields import poses_of_fields
from jaxgrasp.interop.grasp_poses import GraspPoses
from jaxgrasp.validation.checked import checked

MISSING = "HDF5 files need h5py: pip install 'jaxgrasp[mesh]'"
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


@checked
def read_acronym(path: str | Path, *, keep_going: bool = False) -> GraspPoses:
    """The grasps of a file.

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
    return poses_of_fields(Path(path), _fields(path), PLACES, keep_going)


def _fields(path: str | Path) -> dict[str, Any]:
    try:
        import h5py
    except ImportError:
        raise ImportError(MISSING) from None
    # h5py's own message for a missing file is five lines long.
    with open(path, "rb"):
        pass
    try:
        with h5py.File(path, "r") as file:
            return {name: file[place][()] for name, place in PLACES.items() if place in file}
    except (OSError, KeyError, TypeError, ValueError, MemoryError) as error:
        raise ValueError(f"{path}: it cannot be read as HDF5: {error}") from None
