"""``jaxgrasp show``: one grasp of a file, drawn with both answers."""

import jax
import numpy as np

from jaxgrasp.batch.contact_sets import ContactSets
from jaxgrasp.batch.sources import Adjustments
from jaxgrasp.cli.arguments import Show
from jaxgrasp.cli.grasp_files import adjustments_of, data_path, opened
from jaxgrasp.cli.machine import set_up_jax
from jaxgrasp.cli.terminal import show
from jaxgrasp.files.printable import shortened
from jaxgrasp.files.toml_fields import nearest
from jaxgrasp.hand.mesh import load_mesh
from jaxgrasp.model.faults import GraspError
from jaxgrasp.report.shown_grasp import show as draw

CHUNK = 65_536


def show_command(arguments: Show) -> int:
    """Find the grasp, answer, and draw."""
    adjustments = adjustments_of(arguments)
    mesh = None if arguments.mesh is None else load_mesh(arguments.mesh, arguments.scale)
    sets, number = _chosen(arguments, adjustments)
    for fault in sets.faults():
        raise GraspError(fault)
    if not 0 <= arguments.wrench < sets.wrenches:
        raise ValueError(f"wrench is {arguments.wrench}: expected 0 to {sets.wrenches - 1}")
    set_up_jax("float64")
    limits = sets.limits(sets.largest)
    single = jax.tree.map(lambda leaf: leaf[0], limits)
    name = str(sets.labels["name"][0]) if "name" in sets.labels else f"grasp {number}"
    wrench = sets.wrench[0, arguments.wrench]
    draw(
        arguments.out, sets.grasp(0), wrench, limits=single, method=arguments.method, solid=mesh, title=name or "grasp"
    )
    show(f"{arguments.out}: {name}")
    return 0


def _chosen(arguments: Show, adjustments: Adjustments) -> tuple[ContactSets, int]:
    """Return the grasp of the wanted name, or else of that number, as a set of one, and its number in the file."""
    query, first, names = arguments.grasp, 0, list[str]()
    by_name = by_number = None
    with opened(arguments, adjustments) as source:
        for raw in source.chunks(CHUNK):
            if "name" in raw.labels:
                indices = np.flatnonzero(raw.labels["name"] == query)
                numbers = [first + int(k) for k in indices] + ([] if by_name is None else [by_name[1]])
                if len(numbers) > 1:
                    listed = " and ".join(map(str, sorted(numbers)[:2]))
                    raise ValueError(f"grasps {listed} are both named {shortened(query)}: give a number")
                if len(indices):
                    by_name = adjustments.apply(raw.rows(indices)), first + int(indices[0])
                names += raw.labels["name"][: 1000 - len(names)].tolist()
            if query.isdecimal() and first <= int(query) < first + len(raw):
                by_number = adjustments.apply(raw.rows(np.array([int(query) - first]))), int(query)
            first += len(raw)
    if by_name is not None:
        return by_name
    if by_number is None:
        hint = nearest(query, names) if names and not query.isdecimal() else f": expected 0 to {first - 1}"
        raise ValueError(f"{data_path(arguments.file)} holds no grasp {shortened(query)}{hint[:300]}")
    return by_number
