"""``jaxgrasp show``: one grasp of a file, drawn with both answers."""

import jax
import numpy as np

from jaxgrasp.batch.contact_sets import ContactSets
from jaxgrasp.batch.sources import Adjustments
from jaxgrasp.cli.data import adjustments_of, data_path, opened
from jaxgrasp.cli.machine import set_up_jax
from jaxgrasp.cli.show_arguments import Show
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
    solid = None if arguments.mesh is None else load_mesh(arguments.mesh, arguments.scale)
    one, number = _chosen(arguments, adjustments)
    for fault in one.faults():
        raise GraspError(fault)
    if not 0 <= arguments.wrench < one.wrenches:
        raise ValueError(f"wrench is {arguments.wrench}: expected 0 to {one.wrenches - 1}")
    set_up_jax("float64")
    limits = one.limits(one.largest)
    single = jax.tree.map(lambda leaf: leaf[0], limits)
    name = str(one.labels["name"][0]) if "name" in one.labels else f"grasp {number}"
    wrench = one.wrench[0, arguments.wrench]
    draw(
        arguments.out, one.grasp(0), wrench, limits=single, method=arguments.method, solid=solid, title=name or "grasp"
    )
    show(f"{arguments.out}: {name}")
    return 0


def _chosen(arguments: Show, adjustments: Adjustments) -> tuple[ContactSets, int]:
    """Return the grasp of the wanted name, or else of that number, as a set of one, and its number in the file."""
    wanted, first, names = arguments.grasp, 0, list[str]()
    by_name = by_number = None
    with opened(arguments, adjustments) as source:
        for raw in source.chunks(CHUNK):
            if "name" in raw.labels:
                found = np.flatnonzero(raw.labels["name"] == wanted)
                numbers = [first + int(k) for k in found] + ([] if by_name is None else [by_name[1]])
                if len(numbers) > 1:
                    some = " and ".join(map(str, sorted(numbers)[:2]))
                    raise ValueError(f"grasps {some} are both named {shortened(wanted)}: give a number")
                if len(found):
                    by_name = adjustments.apply(raw.rows(found)), first + int(found[0])
                names += raw.labels["name"][: 1000 - len(names)].tolist()
            if wanted.isdecimal() and first <= int(wanted) < first + len(raw):
                by_number = adjustments.apply(raw.rows(np.array([int(wanted) - first]))), int(wanted)
            first += len(raw)
    if by_name is not None:
        return by_name
    if by_number is None:
        hint = nearest(wanted, names) if names and not wanted.isdecimal() else f": expected 0 to {first - 1}"
        raise ValueError(f"{data_path(arguments.file)} holds no grasp {shortened(wanted)}{hint[:300]}")
    return by_number
