"""Pickled files of data sets: plain ones are read as NumPy reads them, and nothing else is ever run."""

import pickle
from pathlib import Path

import numpy as np
import pytest

from jaxgrasp.files.plain_pickle import load_plain


def test_plain_files_are_what_numpy_reads(folder):
    record = {
        "qpos": {"joint": np.float64(0.5), "other": 1.25},
        "array": np.arange(12, dtype=np.float32).reshape(3, 4),
        "whole": np.int32(7),
        "names": np.array(["a", "bc"]),
        "raw": b"\x00\xff",
        "list": [1, 2.5, "text", None, True],
    }
    several = np.empty(3, object)
    several[:] = [record, record, {"scale": np.array(0.06)}]
    for content in (record, several):
        np.save(folder / "file.npy", content, allow_pickle=True)
        found, expected = load_plain("file.npy"), np.load("file.npy", allow_pickle=True)
        expected = expected.item() if expected.shape == () else expected
        np.testing.assert_equal(*(list(x) if isinstance(x, np.ndarray) else x for x in (found, expected)))


class Runs:
    """What leaves a file behind if it is ever made."""

    def __reduce__(self):
        return Path.touch, (Path("ran"),)


def written(folder, pickled: bytes, shape: str = "()") -> None:
    header = f"{{'descr': '|O', 'fortran_order': False, 'shape': {shape}, }}".ljust(117) + "\n"
    (folder / "file.npy").write_bytes(
        b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header.encode() + pickled
    )


HOSTILE = {
    "a call": pickle.dumps(Runs()),
    "eval": b'c__builtin__\neval\n(S\'open("ran", "w")\'\ntR.',
    "an array of 8 TB": b"cnumpy\nndarray\n(I1000000000000\ntR.",
    "an array of 8 TB, made anew": b"cnumpy._core.multiarray\n_reconstruct\n"
    b"(cnumpy\nndarray\n(I1000000000000\ntS'd'\ntR.",
    "a class of NumPy's": b"cnumpy\nmemmap\n(S'ran'\nS'd'\nS'w+'\n(I10\ntI0\ntR.",
    "by its extension": b"\x80\x02\x82\x01.",
    "something outside": b"Pelsewhere\n.",
    "nothing": b"",
    "half of it": pickle.dumps({"a": np.arange(100.0)})[:-40],
    "a stack that is empty": b"R.",
    "a record's kind": b"cnumpy\ndtype\n((lS'a'\nS'f8'\ntatR.",
}


@pytest.mark.parametrize("name", HOSTILE)
def test_what_asks_for_more_is_refused_by_name_and_not_run(folder, name):
    written(folder, HOSTILE[name])
    if name == "an array of 8 TB, made anew":
        assert load_plain("file.npy").size == 0
        return
    with pytest.raises(ValueError, match=r"file\.npy is no plain file of NumPy's: ") as caught:
        load_plain("file.npy")
    assert str(caught.value).count("\n") == 0 and len(str(caught.value)) < 300
    assert not Path("ran").exists()


def test_files_of_another_kind_are_refused(folder):
    np.save(folder / "file.npy", np.arange(3.0))
    with pytest.raises(ValueError, match="it holds float64: expected pickled objects"):
        load_plain("file.npy")
    (folder / "file.npy").write_text("not at all")
    with pytest.raises(ValueError, match="no plain file"):
        load_plain("file.npy")
