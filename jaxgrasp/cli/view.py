"""``jaxgrasp view``: a live hand, a scene, or a file of grasps, in a browser."""

import time
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

from jaxgrasp.batch.sources import FORMATS, open_source
from jaxgrasp.cli.arguments import View
from jaxgrasp.cli.grasp_files import GraspQuery, adjustments_of
from jaxgrasp.cli.machine import compiling, set_up_jax
from jaxgrasp.cli.terminal import show
from jaxgrasp.files.replace import replace_file
from jaxgrasp.grip.scene_entries import TableEntry
from jaxgrasp.grip.scene_file import SceneFile, load_scene, scene_path
from jaxgrasp.hand.mesh import load_mesh
from jaxgrasp.lab.loaded_scene import loaded_scene
from jaxgrasp.model.faults import GraspError
from jaxgrasp.report.surfaces import mesh_surface
from jaxgrasp.validation.checked import check_positive
from jaxgrasp.view.grasp_page import GraspPage, GraspSteps
from jaxgrasp.view.live_page import LivePage
from jaxgrasp.view.live_scene import LiveHand
from jaxgrasp.view.live_world import LiveWorld
from jaxgrasp.view.page_loop import PageLoop
from jaxgrasp.view.viewer_server import RequestGuard, check_free, quiet_viser, serving
from jaxgrasp.world.world_file import world_of

BELOW = 0.4
"""Distance of the table below the object that a hand holds from the start [m]."""


def view_command(arguments: View) -> int:
    """Check what is asked for, compute, and serve until interrupted."""
    check_positive(arguments, "seconds", "scale")
    # What is missing is said before anything compiles.
    quiet_viser()
    RequestGuard(arguments.host, arguments.allowed_hosts)
    if arguments.save is None:
        check_free(arguments.host, arguments.port)
    if arguments.file is not None and Path(arguments.file).suffix.lower() in FORMATS:
        return _grasps(arguments, arguments.file)
    for name in ("grasp", "mesh", "normals", "normalize", "scale"):
        if getattr(arguments, name) != getattr(View, name):
            raise ValueError(f"{name} is given without a file of grasps: expected {', '.join(FORMATS)}")
    return _live(arguments)


def _grasps(arguments: View, file: str) -> int:
    mesh = None if arguments.mesh is None else load_mesh(arguments.mesh, arguments.scale)
    adjustments = adjustments_of(arguments)
    with open_source(file, adjustments) as source:
        raw = next(source.chunks(max(1, len(source))), None)
    sets = None if raw is None else adjustments.apply(raw)
    if sets is None or not len(sets):
        raise ValueError(f"{file} holds no grasps")
    for fault in sets.faults():
        raise GraspError(fault)
    grasp = None
    if arguments.grasp is not None:
        query = GraspQuery(arguments.grasp)
        query.look(sets.labels.get("name"), len(sets))
        grasp = query.number(file)
    set_up_jax("float64")
    with compiling(f"both laws, and answering {len(sets):,} grasps"):
        steps = GraspSteps(sets, arguments.law or "optimum")
    with _server(arguments, Path(file).name) as server:
        surface = None if mesh is None else mesh_surface(mesh)
        page = GraspPage(server, steps, surface, file_name=Path(file).name, grasp=grasp)
        return _show_page(arguments, server, page)


def _live(arguments: View) -> int:
    runs = arguments.file is not None
    file = SceneFile(name="a cylinder", table=TableEntry(below=BELOW))
    if arguments.file is not None:
        file = load_scene(scene_path(arguments.file))
    set_up_jax("float64")
    with compiling("the hand, its contacts and both laws"):
        gripped = loaded_scene(file)
        law = arguments.law or gripped.law
        hand = LiveWorld(gripped, *world_of(file, gripped), law) if file.other else LiveHand(gripped, law)
    with _server(arguments, file.name) as server:
        return _show_page(arguments, server, LivePage(server, hand, runs, name=file.name))


def _server(arguments: View, label: str) -> AbstractContextManager[Any]:
    return serving(arguments.host, 0 if arguments.save else arguments.port, label, arguments.allowed_hosts)


def _show_page(arguments: View, server: Any, page: PageLoop) -> int:
    """Save the page to a file, or serve it until its time is over or the user interrupts it."""
    if arguments.save is not None:
        return _saved(arguments.save, page.html())
    page.frame()
    host = f"[{arguments.host}]" if ":" in arguments.host else arguments.host
    show(f"open http://{host}:{server.get_port()} in a browser; Ctrl-C ends it")
    end = None if arguments.seconds is None else time.perf_counter() + arguments.seconds
    try:
        page.run(lambda: end is None or time.perf_counter() < end)
    except KeyboardInterrupt:
        show("ended")
    return 0


def _saved(path: Path, html: str) -> int:
    replace_file(path, lambda stream: stream.write(html.encode()))
    show(f"written: {path} ({len(html) / 1e6:.1f} MB)")
    return 0
