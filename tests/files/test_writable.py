"""Checks before any work that results can be written, which leave nothing behind."""

import os

import pytest

from jaxgrasp.files.replace import FolderHeldError, check_writable, locked


def test_a_folder_that_is_not_there_yet_is_as_it_was(folder):
    check_writable(folder / "a" / "b")
    check_writable(folder)
    assert not list(folder.iterdir())
    (folder / "a").mkdir()
    check_writable(folder / "a" / "b")
    assert not list((folder / "a").iterdir()) and (folder / "a").is_dir()


def test_what_is_no_folder_is_refused_by_name(folder):
    (folder / "file").write_text("")
    with pytest.raises(OSError, match="out is .*file, where nothing can be written: File exists"):
        check_writable(folder / "file")
    with pytest.raises(OSError, match="out is .*b, where nothing can be written"):
        check_writable(folder / "file" / "b")
    assert [path.name for path in folder.iterdir()] == ["file"]


@pytest.mark.skipif(not os.path.isdir("/proc/self"), reason="needs /proc")
def test_a_system_that_takes_no_folders_is_refused(folder):
    from pathlib import Path

    with pytest.raises(OSError, match="out is /proc/x, where nothing can be written"):
        check_writable(Path("/proc/x"))


def test_one_thing_in_a_folder_is_held_beside_others(folder):
    with locked(folder, part="S1"), locked(folder, part="S2"):
        with pytest.raises(FolderHeldError, match=f"process {os.getpid()}, at work since"), locked(folder, part="S1"):
            raise AssertionError("held twice")
        assert {path.name for path in folder.iterdir()} >= {".S1.lock", ".S2.lock"}
    assert not list(folder.iterdir())
