"""A folder belongs to one process at a time, and to nobody once that is gone."""

import json
import subprocess
import sys
import threading

import pytest

from jaxgrasp.files.printable import printable, shortened
from jaxgrasp.files.replace import LOCK, OWNER, FolderHeldError, locked

HOLD = """
import sys, pathlib
from jaxgrasp.files.replace import locked
with locked(pathlib.Path(sys.argv[1])):
    print("held", flush=True)
    sys.stdin.read()
"""


@pytest.fixture
def other_process(tmp_path):
    """Start another process that holds the folder."""
    process = subprocess.Popen(
        [sys.executable, "-c", HOLD, str(tmp_path)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert process.stdout.readline() == "held\n"
    yield process
    process.kill()
    process.communicate()


def test_a_folder_that_is_held_is_refused_and_the_owner_named(tmp_path, other_process):
    with (
        pytest.raises(FolderHeldError, match=f"process {other_process.pid}, at work since 20.* works in it"),
        locked(tmp_path),
    ):
        pass
    assert (tmp_path / LOCK).exists()
    other_process.communicate("")
    with locked(tmp_path):
        pass
    assert not list(tmp_path.iterdir())


def test_what_a_killed_process_left_is_taken_over_and_said(tmp_path, other_process):
    other_process.kill()
    other_process.wait()
    messages = []
    with locked(tmp_path, messages.append):
        assert f"taken over from process {other_process.pid}" in messages[0]
        assert json.loads((tmp_path / (LOCK + OWNER)).read_text())["process"] != other_process.pid
    assert not list(tmp_path.iterdir())


def test_threads_of_one_process_exclude_one_another(tmp_path):
    observed = []

    def attempt():
        try:
            with locked(tmp_path):
                pass
        except FolderHeldError as error:
            observed.append(str(error))

    with locked(tmp_path):
        thread = threading.Thread(target=attempt)
        thread.start()
        thread.join()
    assert len(observed) == 1 and "works in it" in observed[0]


@pytest.mark.parametrize("content", [b"", b"\xff\x00junk", b"[" * 5000, b'{"process": "x"}', b'{"process": 3}'])
def test_a_file_of_anybody_elses_is_no_owner(tmp_path, content):
    (tmp_path / LOCK).write_bytes(content)
    (tmp_path / (LOCK + OWNER)).write_bytes(content)
    messages = []
    with locked(tmp_path, messages.append):
        assert not messages
    assert not list(tmp_path.iterdir())


def test_links_are_not_followed(tmp_path):
    """A link in the place of the lock or of its record might lead to anyone's file."""
    target = tmp_path / "target"
    target.write_text("kept")
    folder = tmp_path / "folder"
    folder.mkdir()
    (folder / (LOCK + OWNER)).symlink_to(target)
    with locked(folder):
        pass
    (folder / LOCK).symlink_to(target)
    with pytest.raises(OSError), locked(folder):
        pass
    assert target.read_text() == "kept"


def test_an_error_inside_lets_the_folder_go(tmp_path):
    with pytest.raises(ZeroDivisionError), locked(tmp_path):
        _ = 1 / 0
    with locked(tmp_path):
        pass


def test_what_a_terminal_would_act_on_is_escaped():
    assert printable("a\x1b[31mb\n\r\0\x9bc\u202ed é") == "a\\x1b[31mb\\n\\r\\x00\\x9bc\\u202ed é"
    assert len(shortened("x" * 10**6)) < 300 and "1,000,002 characters" in shortened("x" * 10**6)
