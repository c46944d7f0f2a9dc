"""Files by their addresses: read through pyarrow's file systems, here the local one and an object store of our own."""

import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from urllib.parse import parse_qs, urlsplit

import numpy as np
import pytest

import jaxgrasp
from jaxgrasp.batch.cluster_evaluation import parquet_files, read_inputs
from jaxgrasp.batch.file_error import GraspFileError
from jaxgrasp.batch.remote_file import RemoteFile, parse_path
from jaxgrasp.batch.sources import open_source
from tests.batch.conftest import make_sets

pytest.importorskip("pyarrow.fs")


@pytest.fixture
def files(folder) -> list[Path]:
    """Write two files of grasps and one other file; return the paths of the grasps."""
    (folder / "bucket" / "in").mkdir(parents=True)
    paths = [folder / "bucket" / "in" / f"part-{number}.parquet" for number in range(2)]
    for number, file in enumerate(paths):
        jaxgrasp.save_grasps(file, make_sets([3, 4, 3], seed=number))
    (folder / "bucket" / "in" / "notes.txt").write_text("none")
    return paths


class Store(BaseHTTPRequestHandler):
    """Server of the part of the S3 protocol that reading needs; ``root`` holds a folder for each bucket."""

    root: Path

    def do_HEAD(self) -> None:
        self.do_GET()

    def do_GET(self) -> None:
        parts = urlsplit(self.path)
        query = parse_qs(parts.query)
        if "list-type" in query:
            self._answer(200, self._listing(parts.path.strip("/"), query["prefix"][0]).encode())
            return
        file = self.root / parts.path.strip("/")
        if not file.is_file():
            self._answer(404, b"")
            return
        content = file.read_bytes()
        if "Range" not in self.headers:
            self._answer(200, content)
            return
        first, _, last = self.headers["Range"].removeprefix("bytes=").partition("-")
        stop = min(int(last) + 1, len(content))
        self._answer(206, content[int(first) : stop], f"bytes {first}-{stop - 1}/{len(content)}")

    def _listing(self, bucket: str, prefix: str) -> str:
        paths = sorted(path for path in (self.root / bucket / prefix).glob("*") if path.is_file())
        entries = "".join(
            f"<Contents><Key>{prefix}{path.name}</Key><Size>{path.stat().st_size}</Size></Contents>" for path in paths
        )
        return f"<ListBucketResult><IsTruncated>false</IsTruncated>{entries}</ListBucketResult>"

    def _answer(self, code: int, content: bytes, part: str | None = None) -> None:
        self.send_response(code)
        self.send_header("Content-Length", str(len(content)))
        self.send_header("Last-Modified", "Thu, 01 Jan 2026 00:00:00 GMT")
        if part:
            self.send_header("Content-Range", part)
        self.end_headers()
        if self.command == "GET":
            self.wfile.write(content)

    def log_message(self, *_) -> None: ...


@pytest.fixture
def store(folder, monkeypatch) -> Iterator[str]:
    """Start a store of the folder; yield the query (after the ``?``) of addresses in it."""
    for name in ("AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY"):
        monkeypatch.setenv(name, "test")
    monkeypatch.setenv("AWS_EC2_METADATA_DISABLED", "true")
    with ThreadingHTTPServer(("127.0.0.1", 0), type("Here", (Store,), {"root": folder})) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        try:
            yield f"endpoint_override=127.0.0.1:{server.server_port}&scheme=http&region=us-east-1"
        finally:
            server.shutdown()
            thread.join()


def assert_read(places: list, files: list[Path]) -> None:
    tasks = parquet_files([parse_path(place) for place in places])
    assert [file.name for file in tasks] == [file.name for file in files]
    inputs = read_inputs(tasks, False, print)
    assert inputs.grasps == {file.name: 3 for file in files}
    for task, file in zip(inputs.tasks, files, strict=True):
        with open_source(task.path) as remote, open_source(file) as local:
            assert remote.fingerprint == local.fingerprint
            np.testing.assert_array_equal(next(remote.chunks(9)).points, next(local.chunks(9)).points)


def test_files_by_their_addresses_are_those_at_their_paths(files):
    address = f"file://{files[0].parent}"
    assert_read([address], files)
    assert_read([f"{address}/part-*.parquet"], files)
    assert_read([f"{address}/part-[1].parquet"], files[1:])
    assert_read([f"{address}/part-0.parquet", files[1]], files)


def test_a_store_of_objects_is_read_as_a_folder_is(files, store):
    for place in ("", "/*.parquet"):
        assert_read([f"s3://bucket/in{place}?{store}"], files)
    assert_read([f"s3://bucket/in/{file.name}?{store}" for file in files], files)
    with pytest.raises(GraspFileError, match=r"in/part-9.parquet.*it cannot be read as Parquet"):
        read_inputs(parquet_files([RemoteFile(f"s3://bucket/in/part-9.parquet?{store}")]), False, print)


@pytest.mark.parametrize(
    ("address", "message"),
    [
        ("file:///nowhere/at/all", "it holds no file that ends in .parquet"),
        ("nonsense://bucket/*.parquet", "the address cannot be used"),
        ("s3://key:secret@bucket/*.parquet", "the address holds credentials: expected them in the environment"),
    ],
)
def test_an_address_that_cannot_be_used_is_one_line(address, message):
    with pytest.raises(GraspFileError) as caught:
        parquet_files([RemoteFile(address)])
    assert message in str(caught.value) and "\n" not in str(caught.value) and "secret" not in str(caught.value)


def test_only_parquet_is_read_from_elsewhere():
    with pytest.raises(GraspFileError, match="it is a remote file: expected Parquet"):
        open_source("s3://bucket/grasps.npz")
