"""Errors of the operating system carry the file's name: a full device, a loop of links, a missing file."""

import errno
import os
import subprocess
import sys

import pytest

from jaxgrasp.batch.hdf5_file import Hdf5Archive
from jaxgrasp.batch.npz_file import NpzArchive
from jaxgrasp.batch.parquet_file import ParquetArchive
from jaxgrasp.cli.import_grasps import check_import
from jaxgrasp.cli.interop_arguments import ImportGrasps
from jaxgrasp.files.file_values import load_toml, number
from jaxgrasp.files.replace import replace_file
from jaxgrasp.grip.scene_file import load_scene, scene_path
from jaxgrasp.interop import file_records

FULL = pytest.mark.skipif(not os.path.exists("/dev/full"), reason="needs /dev/full")


@FULL
def test_a_full_device_is_named_by_the_file_that_it_should_hold(folder):
    """The bytes of the partial file go to a device without room."""

    def write(stream):
        os.dup2(os.open("/dev/full", os.O_WRONLY), stream.fileno())
        stream.write(b"more than nothing")

    with pytest.raises(OSError, match="No space left on device: '.*results.csv'") as caught:
        replace_file(folder / "results.csv", write)
    assert caught.value.errno == errno.ENOSPC and caught.value.filename == str(folder / "results.csv")
    assert not list(folder.iterdir())


def test_a_folder_that_is_missing_is_named_by_the_file_that_was_asked_for(folder):
    with pytest.raises(FileNotFoundError) as caught:
        replace_file(folder / "missing" / "results.csv", lambda stream: None)
    assert caught.value.filename == str(folder / "missing" / "results.csv")


def test_an_error_of_another_file_keeps_its_name(folder):
    with pytest.raises(FileNotFoundError) as caught:
        replace_file(folder / "results.csv", lambda stream: (folder / "source").read_bytes())
    assert caught.value.filename == str(folder / "source")


@FULL
def test_a_full_standard_output_is_one_line():
    command = [sys.executable, "-c", "from jaxgrasp.cli.main import main; raise SystemExit(main(['--version']))"]
    with open("/dev/full", "wb") as full:
        done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True)
    assert done.returncode == 1
    assert done.stderr == "jaxgrasp: [Errno 28] No space left on device: 'standard output'\n"


@pytest.mark.parametrize("reader", [NpzArchive, Hdf5Archive, ParquetArchive, load_toml, load_scene])
@pytest.mark.parametrize(
    "target, code", [("loop", errno.ELOOP), ("nowhere", errno.ENOENT)], ids=["loop of links", "link to nothing"]
)
def test_a_link_that_leads_to_no_file_is_no_damaged_file(folder, reader, target, code):
    (folder / "loop").symlink_to(folder / target)
    with pytest.raises(OSError) as caught:
        reader(folder / "loop")
    assert caught.value.errno == code and caught.value.filename == str(folder / "loop")


def test_a_file_to_import_that_is_a_loop_of_links_is_no_missing_file(folder):
    (folder / "loop").symlink_to(folder / "loop")
    with pytest.raises(OSError, match="Too many levels of symbolic links"):
        check_import(ImportGrasps(files=(folder / "loop",), out=folder / "out.npz"))


def test_a_scene_that_is_a_loop_of_links_is_a_file(folder):
    (folder / "scene.toml").symlink_to(folder / "scene.toml")
    assert scene_path(str(folder / "scene.toml")) == folder / "scene.toml"


@pytest.mark.parametrize("read", [number, file_records.number], ids=["TOML", "records"])
@pytest.mark.parametrize("value", ["1", "nan?", True, [1, 2], {}, "x" * 1000])
def test_what_is_no_number_is_shown_as_it_stands_in_the_file(read, value):
    with pytest.raises(ValueError) as caught:
        read("object.mass", value)
    assert str(caught.value).startswith(f"object.mass is {repr(value)[:200]}")
    assert len(str(caught.value)) < 300
