"""Latency from a glove's reading to the browser's picture, measured while the page runs."""

import statistics
import threading
import time
from collections import deque
from typing import Any

from jaxgrasp.report.look import seconds

KEPT = 60
"""Number of latest frames in the median."""
EVERY = 1.0
"""Time between two questions to a browser [s]."""
PATIENCE = 5.0


class Latency:
    """Median times of the latest frames, and how soon a browser answers."""

    def __init__(self, server: Any) -> None:
        self._server = server
        self._sent: deque[float] = deque(maxlen=KEPT)
        self._times: deque[float] = deque(maxlen=KEPT)
        self._answer: float | None = None
        self._asked = threading.Event()

    def shown(self, angles_at: float) -> None:
        """Record that a frame is sent now, with angles that were read at ``angles_at`` [s]."""
        now = time.perf_counter()
        self._sent.append(now - angles_at)
        self._times.append(now)

    def ask(self) -> None:
        """Ask a browser, where there is one, for a sign that it has what was sent; nothing waits for it."""
        clients = self._server.get_clients()
        if clients and not self._asked.is_set():
            self._asked.set()
            threading.Thread(target=self._wait, args=(next(iter(clients.values())),), daemon=True).start()

    def text(self) -> str:
        """Return the latency in words: frame rate, time from angles to sent picture, and browser's round trip."""
        if len(self._times) < 2:
            return ""
        rate = (len(self._times) - 1) / max(self._times[-1] - self._times[0], 1e-9)
        said = f"{rate:.0f} frames a second; {seconds(statistics.median(self._sent))} from angles to picture sent"
        return said if self._answer is None else f"{said}; the browser answers after {seconds(self._answer)}"

    def _wait(self, client: Any) -> None:
        begun = time.perf_counter()
        try:
            client.local_storage.get_item("jaxgrasp", timeout=PATIENCE)
            self._answer = time.perf_counter() - begun
        except (RuntimeError, TimeoutError):
            # It has gone, or is busy: nothing is known of it.
            self._answer = None
        time.sleep(EVERY)
        self._asked.clear()
