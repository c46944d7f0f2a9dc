"""``jaxgrasp import`` of formats that have contacts themselves."""

from pathlib import Path

import numpy as np

from jaxgrasp.batch.contact_sets import ContactSets
from jaxgrasp.cli.contacts_found import write_contacts
from jaxgrasp.cli.import_arguments import BODex, ImportContacts
from jaxgrasp.cli.import_files import FRICTION, MASS, check_import, read_files
from jaxgrasp.cli.machine import set_up_jax
from jaxgrasp.cli.posed_contacts import in_world, joined_sets, weights
from jaxgrasp.hand.mesh import load_mesh, mass_properties
from jaxgrasp.interop.bodex import read_bodex
from jaxgrasp.interop.contact_records import ContactRecords
from jaxgrasp.interop.dexonomy import read_dexonomy
from jaxgrasp.validation.fields import check_not_negative, check_positive


def import_contacts(arguments: ImportContacts) -> int:
    """Read, write, and say what was found."""
    check_positive(arguments, "force")
    check_not_negative(arguments, "squeeze", "torsion")
    if arguments.center is not None and not np.all(np.isfinite(arguments.center)):
        raise ValueError(f"center is {arguments.center}: expected finite numbers [m]")
    object_ = arguments.object if isinstance(arguments, BODex) else None
    check_import(arguments, *([object_] if object_ is not None and not object_.is_dir() else []))
    set_up_jax("float64")
    parts = []

    def read(path: Path) -> ContactRecords:
        records = (
            read_bodex(path, keep_going=arguments.keep_going) if isinstance(arguments, BODex) else read_dexonomy(path)
        )
        parts.append(_sets(arguments, records, object_))
        return records

    files_read = read_files(arguments, read)
    names = [f"{records.path.stem} {name}" for records in files_read for name in records.names]
    sets = joined_sets(parts)
    labels = {"name": np.array(names), "source": np.full(len(names), type(arguments).__name__)}
    return write_contacts(arguments.out, sets, labels, {"without contacts": sets.sizes == 0})


def _sets(arguments: ImportContacts, records: ContactRecords, object_: Path | None) -> ContactSets:
    """Return contacts with the wrench to be exerted: against the weight, and against the loads of the file."""
    friction = FRICTION if arguments.friction is None else arguments.friction
    mass = MASS if arguments.mass is None else arguments.mass
    pressures = np.where(np.isnan(records.pressures), arguments.squeeze, arguments.force * records.pressures)
    weight = weights(mass, _centers(arguments, records, object_), arguments.gravity)
    return ContactSets(
        records.points,
        records.normals,
        np.full(len(records.points), friction),
        pressures,
        records.offsets,
        (weight - arguments.force * records.loads)[:, None],
        torsion=None if arguments.torsion is None else np.full(len(records.points), arguments.torsion),
    )


def _centers(arguments: ImportContacts, records: ContactRecords, object_: Path | None) -> np.ndarray:
    """Return centres of mass ``(N, 3)`` in the file's world [m]: the user's, the file's, or the mesh's."""
    if arguments.center is not None:
        return np.tile(arguments.center, (len(records), 1))
    if np.isfinite(records.centers).all():
        return records.centers
    mesh = records.mesh_path(object_) if object_ is None or object_.is_dir() else object_
    if mesh is None or records.objects is None or records.scales is None:
        options = "--center or its mesh by --object" if isinstance(arguments, BODex) else "--center"
        raise ValueError(f"{records.path} does not say the object's centre of mass: give it by {options}")
    middle = records.scales * mass_properties(load_mesh(mesh)).center
    return in_world(records.objects, middle)
