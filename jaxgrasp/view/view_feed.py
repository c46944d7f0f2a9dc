"""Haptic loop's handle on the process that shows it: the process skips frames that it does not read in time."""

import pickle
import tempfile
from pathlib import Path
from typing import Any

import jax

from jaxgrasp.glove.loop.child import WorkerProcess
from jaxgrasp.glove.loop.exchange import Slot
from jaxgrasp.view.view_slots import ViewFrame
from jaxgrasp.view.viewer_server import HOST, check_free, quiet_viser

SLOT, SHOWN = "frames", "shown.pickle"
"""Files in the folder that both processes share, which is this user's alone."""
COMPILES = 600.0
"""Longest time until the process listens [s]: minutes on a machine with an empty compilation cache."""


class ViewFeed:
    """Page in its own process; a context manager that ends it. If the process is killed, the loop goes on."""

    def __init__(self, channels: int, more: int, shown: dict[str, Any], ports: tuple[int, ...]) -> None:
        """Start the process of the page and wait until it listens.

        Args:
            channels: of the glove.
            more: numbers of each frame beside those of the channels.
            shown: what [`view_process`][jaxgrasp.view.view_process] shows, by its names.
            ports: of the page, or of the subject's and the experimenter's.

        Raises:
            OSError: for a port that is taken, or if it does not come to listen.
            ImportError: viser is not installed.
        """
        quiet_viser()
        for port in ports:
            check_free(HOST, port, "--view-port")
        self._folder = tempfile.TemporaryDirectory(prefix="jaxgrasp-view-")
        folder = Path(self._folder.name)
        self._slot = Slot(folder / SLOT, ViewFrame.size(channels, more), create=True)
        (folder / SHOWN).write_bytes(pickle.dumps(jax.device_get(shown)))
        options = {"folder": str(folder), "channels": channels, "more": more, "ports": ports}
        self._child = WorkerProcess("jaxgrasp.view.view_process", options)
        try:
            message = self._child.wait_for(
                lambda message: "listens" in message or "failed" in message, patience=COMPILES
            )
            if "failed" in message:
                raise OSError(message["failed"])
        except BaseException:
            self.close()
            raise
        self.addresses: list[str] = message["listens"]

    @property
    def process_id(self) -> int:
        """Number of the process that shows the page."""
        return self._child.process.pid

    def write(self, frame: ViewFrame) -> None:
        """Copy a frame to the slot for the page to show; this does not wait."""
        self._slot.write(frame.vector())

    def close(self) -> None:
        """End the page."""
        self._child.close()
        self._slot.close()
        self._folder.cleanup()

    def __enter__(self) -> "ViewFeed":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
