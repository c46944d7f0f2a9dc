"""``jaxgrasp view``: a live hand, a scene, or a file of grasps, in a browser."""

import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from jaxgrasp.cli.machine import say_compiling, set_up_jax
from jaxgrasp.cli.terminal import show
from jaxgrasp.cli.view_arguments import View
from jaxgrasp.files.replace import replace_file
from jaxgrasp.grip.scene_entries import TableEntry
from jaxgrasp.grip.scene_file import SceneFile, gripped_scene, load_scene, scene_path
from jaxgrasp.validation.fields import check_positive
from jaxgrasp.view.live_hand import LiveHand
from jaxgrasp.view.live_page import LivePage
from jaxgrasp.view.viewer_server import check_free, quiet_viser, serving

GRASPS = (".npz", ".csv", ".parquet", ".h5", ".hdf5")
BELOW = 0.4
"""How far the table is below the object that a hand holds from the start [m]."""


def view_command(arguments: View) -> int:
    """Check what is asked for, compute, and serve until interrupted."""
    check_positive(arguments, "seconds", "scale")
    # What is missing is said before anything compiles.
    quiet_viser()
    if arguments.save is None:
        check_free(arguments.host, arguments.port)
    return _live(arguments)


def _live(arguments: View) -> int:
    runs = arguments.file is not None
    file = replace(SceneFile(name="a cylinder"), table=TableEntry(below=BELOW))
    if arguments.file is not None:
        file = load_scene(scene_path(arguments.file))
    set_up_jax("float64")
    say_compiling("the hand, its contacts and both laws", "a minute or two")
    made = gripped_scene(file)
    hand = LiveHand(made, arguments.law or made.law)
    with serving(arguments.host, 0 if arguments.save else arguments.port, file.name) as server:
        page = LivePage(server, hand, runs)
        page.frame(0.0)
        if arguments.save is not None:
            return _saved(arguments.save, page.html())
        return _served(arguments, server.get_port(), page.run)


def _saved(path: Path, html: str) -> int:
    replace_file(path, lambda stream: stream.write(html.encode()))
    show(f"written: {path} ({len(html) / 1e6:.1f} MB)")
    return 0


def _served(arguments: View, port: int, run: Callable[[Callable[[], bool]], None]) -> int:
    """Run a page until its time is over, or somebody interrupts it."""
    show(f"open http://{arguments.host}:{port} in a browser; Ctrl-C ends it")
    end = None if arguments.seconds is None else time.perf_counter() + arguments.seconds
    try:
        run(lambda: end is None or time.perf_counter() < end)
    except KeyboardInterrupt:
        show("ended")
    return 0
