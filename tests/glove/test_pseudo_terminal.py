"""The pseudo-terminal's name: whole, its own, and gone with it."""

import os
import sys
import threading

import pytest

pytest.importorskip("pty", reason="the simulated glove needs pseudo-terminals")

from jaxgrasp.glove.simulated.simulator_process import PseudoTerminal


def leads_to_a_terminal(link) -> bool:
    return os.path.exists(link) and os.readlink(link).startswith("/dev/")


def test_many_in_one_process_share_a_folder_and_a_name(tmp_path):
    """Each plugs in and out again and again; none fails, the last name stands, and nothing is left beside it."""
    link = tmp_path / "glove"
    terminals = [PseudoTerminal(link, 115_200) for _ in range(4)]
    failures: list[BaseException] = []

    def plug_again(terminal) -> None:
        try:
            for _ in range(100):
                terminal.plug()
                terminal.unplug()
        except BaseException as error:
            failures.append(error)

    threads = [threading.Thread(target=plug_again, args=(terminal,)) for terminal in terminals]
    # By default a thread plugs in and out within its turn.
    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    try:
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    finally:
        sys.setswitchinterval(interval)
    assert failures == [] and list(tmp_path.iterdir()) == []


def test_links_that_killed_ones_left_are_in_nobodys_way(tmp_path):
    link = tmp_path / "glove"
    left = tmp_path / f".glove.{os.getpid()}"
    for stale in (link, left):
        stale.symlink_to("/dev/pts/none")
    terminal = PseudoTerminal(link, 115_200)
    terminal.plug()
    assert leads_to_a_terminal(link)
    terminal.unplug()
    assert list(tmp_path.iterdir()) == [left]


def test_a_name_that_another_has_taken_stays_its_own(tmp_path):
    link = tmp_path / "glove"
    first, second = PseudoTerminal(link, 115_200), PseudoTerminal(link, 115_200)
    first.plug()
    second.plug()
    first.unplug()
    assert leads_to_a_terminal(link)
    second.unplug()
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_is_not_there(tmp_path):
    terminal = PseudoTerminal(tmp_path / "none" / "glove", 115_200)
    with pytest.raises(FileNotFoundError):
        terminal.plug()
    terminal.unplug()
    assert terminal.read(0.0) == b""
