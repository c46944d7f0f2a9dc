"""Loop that all pages share: a change triggers a new solution, its drawing, and its words in the panel."""

import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any

import numpy as np

from jaxgrasp.view.drawing import Drawing, SolvedGrasp, drawing, scaled_twist, share_at
from jaxgrasp.view.panel_words import contacts_html, torques_html, words_html
from jaxgrasp.view.viewer import Viewer

RATE = 30.0
"""Frames per second while objects move."""


class PageLoop(ABC):
    """Page that draws the result of ``solve_frame`` in its own loop; browsers only set the inputs that it reads."""

    def __init__(self, viewer: Viewer, size: float = 1.0):
        self.viewer = viewer
        self.size = size
        """Size of drawn parts relative to those beside a human hand."""
        self._heading: Any = None
        """Line above the verdicts, where a page has one."""
        self._changed = threading.Event()
        self._drawn: Drawing | None = None
        self._twist: np.ndarray | None = None
        self._since = 0.0
        self.seconds = 0.0
        """Duration of the last frame, from reading the inputs to sending the drawing [s]."""

    @property
    def runs(self) -> bool:
        """True if objects move without an input."""
        return False

    @property
    def title(self) -> str:
        """Title of the saved page; empty for the default."""
        return ""

    @abstractmethod
    def solve_frame(self, dt: float) -> SolvedGrasp | None:
        """Return the grasp to show, ``dt`` [s] after the last call; None if it has not changed."""

    @abstractmethod
    def corners(self, solved: SolvedGrasp) -> np.ndarray:
        """Return the corners of the object in the world ``(V, 3)`` [m], which limit the shown length of a twist."""

    def change(self, *_: object) -> None:
        """Request a new frame after an input has changed."""
        self._changed.set()

    def add_words(self) -> None:
        """Add the verdicts at the top of the panel."""
        self._words = self.viewer.server.gui.add_html("")

    def add_tables(self, with_torques: bool = True) -> None:
        """Add the table of contacts and, with a hand, the bars of the torques to the panel."""
        gui = self.viewer.server.gui
        with gui.add_folder("contacts"):
            self._contacts = gui.add_html("")
        with gui.add_folder("torques", visible=with_torques):
            self._torques = gui.add_html("")

    def run(self, is_running: Callable[[], bool] = lambda: True) -> None:
        """Show what is asked for until it goes on no more."""
        due_s = last_s = time.perf_counter()
        while is_running():
            now_s = time.perf_counter()
            if self.runs or self._changed.is_set():
                self.frame(now_s - last_s)
            elif self._twist is not None:
                self.viewer.show_escape(self._twist, share_at(now_s - self._since))
            last_s = now_s
            # What was slept too long is made up for; who is woken early does not wait the longer for it.
            due_s = max(min(due_s, now_s) + 1 / RATE, time.perf_counter())
            remaining_s = due_s - time.perf_counter()
            if remaining_s > 0 and (self.runs or self._twist is not None):
                time.sleep(remaining_s)
            elif remaining_s > 0:
                self._changed.wait(remaining_s)

    def frame(self, dt: float = 0.0) -> None:
        """Compute and show one instant."""
        start_s = time.perf_counter()
        # What is set from here on belongs to the next.
        self._changed.clear()
        solved = self.solve_frame(dt)
        if solved is None:
            return
        self._drawn = drawing(solved, None if self._drawn is None else self._drawn.scale, self.size)
        self.viewer.show(self._drawn)
        self._words.content = self.verdict_html(solved)
        self._contacts.content, self._torques.content = contacts_html(solved), self.torques_html(solved)
        self._set_twist(solved)
        self.seconds = time.perf_counter() - start_s

    def torques_html(self, solved: SolvedGrasp) -> str:
        """Return the HTML of the torques in the panel."""
        return torques_html(solved)

    def verdict_html(self, solved: SolvedGrasp) -> str:
        """Return the HTML of the verdicts at the top of the panel."""
        assert self._drawn is not None
        return words_html(solved, self._drawn.scale)

    def html(self) -> str:
        """Return the page with its current scene and words as an HTML file that opens offline."""
        self.frame()
        parts = (self._heading, self._words, self._contacts, self._torques)
        words = "".join(part.content for part in parts if part is not None)
        return self.viewer.html(words, self.title)

    def _set_twist(self, solved: SolvedGrasp) -> None:
        escape = None if self.runs or solved.rests else solved.escape
        if escape is None:
            self._twist = None
            return
        if self._twist is None:
            self._since = time.perf_counter()
        self._twist = scaled_twist(escape, solved.origin, self.corners(solved), self.size)
