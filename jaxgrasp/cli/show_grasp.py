"""``jaxgrasp show``: one grasp of a file, drawn with both answers."""

import jax

from jaxgrasp.batch.contact_sets import ContactSets
from jaxgrasp.batch.sources import Adjustments
from jaxgrasp.cli.arguments import Show
from jaxgrasp.cli.grasp_files import GraspQuery, adjustments_of, data_path, opened
from jaxgrasp.cli.machine import set_up_jax
from jaxgrasp.cli.terminal import show
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
    query = GraspQuery(arguments.grasp)
    with opened(arguments, adjustments) as source:
        for raw in source.chunks(CHUNK):
            query.look(raw.labels.get("name"), len(raw))
        number = query.number(str(data_path(arguments.file)))
        return adjustments.apply(next(source.chunks(1, number))), number
