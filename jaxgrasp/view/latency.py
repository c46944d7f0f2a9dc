"""Latency from a glove's reading to the browser's picture, measured while the page runs."""

import statistics
import threading
import time
from collections import deque
from typing import Any

from jaxgrasp.report.look import seconds

N_FRAMES = 60
"""Number of latest frames in the median."""
ASK_PERIOD = 1.0
"""Time between two questions to a browser [s]."""
PATIENCE = 5.0


class Latency:
    """Median times of the latest frames, and how soon a browser answers."""

    def __init__(self, server: Any) -> None:
        self._server = server
        self._sent: deque[float] = deque(maxlen=N_FRAMES)
        self._times: deque[float] = deque(maxlen=N_FRAMES)
        self._answer: float | None = None
        self._is_asking = threading.Event()

    def record_frame(self, angles_at: float) -> None:
        """Record that a frame is sent now, with angles that were read at ``angles_at`` [s]."""
        sent_at = time.perf_counter()
        self._sent.append(sent_at - angles_at)
        self._times.append(sent_at)

    def ask(self) -> None:
        """Ask a browser, where there is one, for a sign that it has what was sent; nothing waits for it."""
        clients = self._server.get_clients()
        if clients and not self._is_asking.is_set():
            self._is_asking.set()
            threading.Thread(target=self._wait, args=(next(iter(clients.values())),), daemon=True).start()

    def text(self) -> str:
        """Return the latency in words: frame rate, time from angles to sent picture, and browser's round trip."""
        if len(self._times) < 2:
            return ""
        rate = (len(self._times) - 1) / max(self._times[-1] - self._times[0], 1e-9)
        summary = f"{rate:.0f} frames a second; {seconds(statistics.median(self._sent))} from angles to picture sent"
        return summary if self._answer is None else f"{summary}; the browser answers after {seconds(self._answer)}"

    def _wait(self, client: Any) -> None:
        start_s = time.perf_counter()
        try:
            client.local_storage.get_item("jaxgrasp", timeout=PATIENCE)
            self._answer = time.perf_counter() - start_s
        except (RuntimeError, TimeoutError):
            # It has gone, or is busy: nothing is known of it.
            self._answer = None
        time.sleep(ASK_PERIOD)
        self._is_asking.clear()
