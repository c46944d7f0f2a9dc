"""Pickled files of data sets: plain ones are read as NumPy reads them, and nothing else is ever run."""

import io
import pickle
from pathlib import Path

import numpy as np
import pytest

from jaxgrasp.files import plain_pickle
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
        result, expected = load_plain("file.npy"), np.load("file.npy", allow_pickle=True)
        expected = expected.item() if expected.shape == () else expected
        np.testing.assert_equal(*(list(x) if isinstance(x, np.ndarray) else x for x in (result, expected)))


class Runs:
    """Object whose unpickling leaves a file behind."""

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
    with pytest.raises(ValueError, match=r"file\.npy is not a plain NumPy file: ") as caught:
        load_plain("file.npy")
    assert str(caught.value).count("\n") == 0 and len(str(caught.value)) < 300
    assert not Path("ran").exists()


def test_files_of_another_kind_are_refused(folder):
    np.save(folder / "file.npy", np.arange(3.0))
    with pytest.raises(ValueError, match="it holds float64: expected pickled objects"):
        load_plain("file.npy")
    (folder / "file.npy").write_text("not at all")
    with pytest.raises(ValueError, match="not a plain NumPy file"):
        load_plain("file.npy")


HEADER = io.BytesIO()
np.lib.format.write_array_header_1_0(HEADER, {"descr": "|O", "fortran_order": False, "shape": ()})
HEADER = HEADER.getvalue()


def pickled_value(value) -> bytes:
    """Return the opcodes of a plain value."""
    return pickle.dumps(value, 2)[2:-1]


def called(module: str, name: str) -> bytes:
    return f"c{module}\n{name}\n".encode()


def kind_with(spelled: str, flags: int, size: int = -1) -> bytes:
    made = called("numpy", "dtype") + pickled_value((spelled, False, True)) + b"R"
    return made + pickled_value((3, "|", None, None, None, size, size, flags)) + b"b"


def array_of(shape: tuple, kind: bytes, data) -> bytes:
    array = called("numpy", "ndarray") + pickled_value((0,)) + pickled_value(b"b")
    reconstructed = called("numpy.core.multiarray", "_reconstruct") + b"(" + array + b"tR"
    return (
        reconstructed
        + b"("
        + pickled_value(1)
        + pickled_value(shape)
        + kind
        + pickled_value(False)
        + pickled_value(data)
        + b"tb"
    )


@pytest.mark.parametrize(
    "program",
    [
        array_of((2,), kind_with("O8", 0), b"A" * 16),
        array_of((2,), kind_with("S8", 63, 8), [1, 2]),
        array_of((2,), kind_with("f8", 63), [1, 2]),
        array_of((1,), kind_with("S8", 0, 10**9), b"A" * 16),
        array_of((-1,), kind_with("f8", 0), b"A" * 8),
        array_of((2**39, 2**39), kind_with("f8", 0), b"A" * 8),
        called("numpy", "dtype") + pickled_value(({"names": ["a"], "formats": ["O"]},)) + b"R",
        called("numpy", "dtype") + pickled_value(("O",)) + b"R",
        called("numpy.core.multiarray", "scalar")
        + pickled_value((None, {"__defaults__": (7,), "__doc__": "x"}))
        + b"b",
        called("numpy.core.multiarray", "scalar") + pickled_value({"_call": print}["_call"].__name__) + b"b",
        called("numpy.core.multiarray", "scalar") + pickled_value((None, {"_call": 3})) + b"b",
        called("numpy", "ndarray") + pickled_value((2,)) + b"R",
        called("numpy", "ndarray"),
        b"]q\x00(h\x00e",
    ],
)
def test_no_program_gets_hold_of_anything_but_records(folder, program):
    """Objects as raw bytes, flags of kinds, functions' own parts, lists in themselves: one line, nothing changed."""
    before = plain_pickle._scalar.__defaults__, {name: allowed._call for name, allowed in plain_pickle.ALLOWED.items()}
    (folder / "some.npy").write_bytes(HEADER + b"\x80\x02" + program + b".")
    with pytest.raises(ValueError, match="some.npy is not a plain NumPy file: "):
        load_plain(folder / "some.npy")
    assert before == (
        plain_pickle._scalar.__defaults__,
        {n: allowed._call for n, allowed in plain_pickle.ALLOWED.items()},
    )


def test_few_bytes_do_not_become_many_numbers(folder):
    many = [1.0]
    for _ in range(60):
        many = [many, many]
    np.save(folder / "many.npy", np.array({"a": many}, dtype=object), allow_pickle=True)
    with pytest.raises(ValueError, match="holds more than 50,000,000 numbers in lists"):
        load_plain(folder / "many.npy")
    shared = [1.0, 2.0]
    np.save(folder / "few.npy", np.array({"a": [shared] * 50}, dtype=object), allow_pickle=True)
    assert load_plain(folder / "few.npy") == {"a": [shared] * 50}
