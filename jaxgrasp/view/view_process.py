"""The process that shows a haptic loop: ``python -m jaxgrasp.view.view_process``; options come as JSON.

What to show lies in a pickle in the folder that the loop made for it. The end of its standard input, which comes with
the end of the loop's process however that ends, ends it too; a Ctrl-C at the terminal is for the loop to answer.
"""

import contextlib
import json
import os
import pickle
import signal
import sys
import threading
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jax

from jaxgrasp.glove.loop.child import tell
from jaxgrasp.glove.loop.exchange import Slot
from jaxgrasp.numerics.compiled_code import use_cache
from jaxgrasp.view.experiment_pages import ExperimentPages
from jaxgrasp.view.followed_page import FollowedPage
from jaxgrasp.view.live_scene import LiveHand
from jaxgrasp.view.live_world import LiveWorld
from jaxgrasp.view.view_slots import SHOWN, SLOT, ViewFrame
from jaxgrasp.view.viewer_server import HOST, serving

if TYPE_CHECKING:
    from jaxgrasp.view.teleop_page import TeleopPage

POLITE = 10
"""Niceness of this process, so that the loop goes first when processors are short."""


def main() -> None:
    """Serve until the standard input ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if hasattr(os, "nice"):
        os.nice(POLITE)
    over = threading.Event()
    threading.Thread(target=_wait_for_end, args=(over,), daemon=True).start()
    jax.config.update("jax_enable_x64", True)
    with contextlib.suppress(OSError):
        use_cache()
    try:
        _serve(json.loads(sys.argv[1]), over)
    except (OSError, ImportError, ValueError) as error:
        tell({"failed": str(error)})


def _serve(options: dict[str, Any], over: threading.Event) -> None:
    folder = Path(options["folder"])
    slot = Slot(folder / SLOT, ViewFrame.size(options["channels"], options["more"]))
    shown = pickle.loads((folder / SHOWN).read_bytes())
    with contextlib.ExitStack() as stack:
        # The token comes by the file, which is this user's alone: arguments of a process are for all to see.
        host, tokens = options.get("host", HOST), shown.get("tokens") or [""] * len(options["ports"])
        servers = [
            stack.enter_context(serving(host, port, token=token))
            for port, token in zip(options["ports"], tokens, strict=True)
        ]
        page = _page(servers, shown, slot)
        page.show_initial()
        tell({"listens": [server.get_port() for server in servers]})
        page.run(lambda: not over.is_set())


def _page(servers: list[Any], shown: dict[str, Any], slot: Slot) -> "FollowedPage | ExperimentPages | TeleopPage":
    if "teleop" in shown:
        from jaxgrasp.view.teleop_page import TeleopPage

        return TeleopPage(servers[0], shown["teleop"], shown["place"], shown["joints"], shown["limits"], slot)
    if "felt" in shown:
        return ExperimentPages((servers[0], servers[1]), shown["felt"], shown["model"], shown["kind"], slot)
    gripped, law = shown["made"], shown["law"]
    hand = LiveWorld(gripped, shown["world"], shown["state"], law) if "world" in shown else LiveHand(gripped, law)
    return FollowedPage(servers[0], hand, shown["worn"], slot)


def _wait_for_end(over: threading.Event) -> None:
    sys.stdin.read()
    over.set()


if __name__ == "__main__":
    main()
