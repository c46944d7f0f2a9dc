"""Dexonomy's files: grasps and templates with their contacts, and the forces that its own optimisation found.

A file is one pickled record, in the world in which the object stands; lengths in metres. Where a grasp was finished,
``ho_c`` holds its contacts out of MuJoCo: ``pos`` (n, 3), a little before the object's surface, ``normal`` (n, 3), from
the hand into the object, and ``wrench`` (n, 6), ten times the force and the torque about ``ext_center`` of its
quadratic program, in which every contact presses by at most 1 and all together by at least 1. These wrenches balance
``ext_wrench``, force and torque about ``ext_center`` that pull at the object (zero for force closure), ten times.
``ext_center`` is the object's centre of mass; older files call it ``obj_gravity_center``.

Where there is no ``ho_c``, the contacts that were aimed at are used: ``obj_cpn_w`` (n, 6), points of the object and
directions into it, or of a template, which knows no object, ``hand_cpn_w`` (n, 6), points of the hand and directions
out of it. Older files call them ``obj_worldframe_contacts`` and ``hand_worldframe_contacts``. Forces these have none.

Friction is not in the files; Dexonomy solved its program with 0.6, and 0.02 m for the torque about the normal, which
some of the wrenches hold and a hard finger has not. The joints, in the order of the MJCF of the hand, the names of its
bodies and templates, and ``scene_path`` or ``scene_cfg``, where the object's mesh stands in the world, are not needed.

Source: Chen et al., Dexonomy, 2025; https://github.com/JYChen18/Dexonomy, ``dexonomy/op/gen_init.py`` and
``dexonomy/op/gen_grasp.py``.
"""

from pathlib import Path
from typing import Any

import numpy as np

from jaxgrasp.files.plain_pickle import load_plain
from jaxgrasp.interop.file_records import (
    ContactRecords,
    OneGrasp,
    contact_records,
    directions,
    field,
    numbers,
    pressing,
    read_each,
    warn_unused,
)
from jaxgrasp.validation.checked import checked

TIMES = 10.0
"""Ratio of the wrenches in a file to the wrenches of the quadratic program."""
AIMED = ("obj_cpn_w", "obj_worldframe_contacts", "hand_cpn_w", "hand_worldframe_contacts")
CENTERS = ("ext_center", "obj_gravity_center")
NOT_NEEDED = (
    "evolution_num",
    "grasp_pose",
    "hand_cbody",
    "hand_contact_body_names",
    "hand_name",
    "hand_template_name",
    "hand_type",
    "n_evo",
    "necessary_contact_body_names",
    "obj_gravity_direction",
    "pregrasp_qpos",
    "required_cbody",
    "scene_cfg",
    "scene_path",
    "squeeze_qpos",
    "tmpl_name",
)
"""Fields about the hand, the scene and the search for the grasp; a warning names whatever else a record has."""
USED_OF_CONTACTS = ("pos", "normal", "wrench", "dist", "bn1", "bn2")
"""Fields of ``ho_c`` that are read, or that are distances and names of bodies."""


@checked
def read_dexonomy(path: str | Path) -> ContactRecords:
    """Read the grasp, or the template, of a Dexonomy file.

    Args:
        path: a ``.npy`` file.

    Returns:
        Contacts in the file's world. The unit of pressures and loads is ten times the largest force of a contact.

    Warns:
        UserWarning: naming the fields that are not used.

    Raises:
        ValueError: for a file that is none of Dexonomy's, naming the field that is wrong.
        OSError: for a file that cannot be read.
    """
    record = load_plain(path)
    grasps, _ = read_each(path, [("0", record)], _grasp, keep_going=False)
    contacts = record.get("ho_c")
    names = [*record, *(f"ho_c.{name}" for name in (contacts if isinstance(contacts, dict) else ()))]
    used = ("grasp_qpos", "ho_c", "ext_wrench", *AIMED, *CENTERS, *NOT_NEEDED)
    warn_unused("Dexonomy", names, (*used, *(f"ho_c.{name}" for name in USED_OF_CONTACTS)))
    return contact_records(path, grasps, ())


def _grasp(record: Any) -> OneGrasp:
    field(record, "grasp_qpos")
    points, normals, pressures = _contacts(record)
    raw_center = next((record[name] for name in CENTERS if record.get(name) is not None), None)
    center = np.full(3, np.nan) if raw_center is None else numbers(CENTERS[0], raw_center, (3,))
    pull = record.get("ext_wrench")
    load = np.zeros(6) if pull is None else TIMES * numbers("ext_wrench", pull, (6,))
    if load.any():
        if raw_center is None:
            raise ValueError("it has an ext_wrench, but no ext_center that it is about")
        # Torque about the origin instead of the centre c: tau_0 = tau_c + c x f.
        load[3:] += np.cross(center, load[:3])
    return OneGrasp(points, normals, pressures, center, load)


def _contacts(record: dict) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Read points, normals and pressures of the best contacts that the record has."""
    contacts = record.get("ho_c")
    if isinstance(contacts, dict) and np.size(contacts.get("pos", ())):
        points = numbers("ho_c.pos", field(contacts, "pos"), (None, 3))
        normals = directions("ho_c.normal", field(contacts, "normal"))
        if len(normals) != len(points):
            raise ValueError(f"ho_c.normal has {len(normals)} rows: expected {len(points)}, as ho_c.pos has")
        if contacts.get("wrench") is None:
            return points, normals, np.full(len(points), np.nan)
        wrenches = numbers("ho_c.wrench", contacts["wrench"], (len(points), 6))
        return points, normals, pressing("ho_c.wrench", np.einsum("ni,ni->n", wrenches[:, :3], normals))
    for name in AIMED:
        if record.get(name) is not None:
            points_and_normals = numbers(name, record[name], (None, 6))
            if not len(points_and_normals):
                raise ValueError(f"{name} is empty: expected contacts")
            return (
                points_and_normals[:, :3],
                directions(f"{name}[:, 3:]", points_and_normals[:, 3:]),
                np.full(len(points_and_normals), np.nan),
            )
    raise ValueError(f"it has no contacts: expected ho_c, {', '.join(AIMED[:-1])} or {AIMED[-1]}")
