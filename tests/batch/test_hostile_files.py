"""Files made to do harm: none costs memory beyond its own size, and each is answered by one line that names it."""

import io
import json
import struct
import subprocess
import sys
import zipfile

import numpy as np
import pytest

import jaxgrasp
from jaxgrasp.cli.main import main
from tests.batch.conftest import make_sets
from tests.batch.test_files import CSV, ROW, columns

LARGE = 2 << 30
"""Bytes of address space beyond what is in use at first that a reader may ask for."""


def members(**changes) -> dict[str, bytes]:
    """Return the columns of two good grasps as bytes, some of them replaced by ``changes``."""
    good = columns(make_sets([3, 5]), name=np.array(["a", "b"]))
    return {name: _bytes(array) for name, array in good.items()} | changes


def column(shape: str, descr: str = "<f8", data: bytes = b"", version: int = 1) -> bytes:
    """Return a ``.npy`` column whose header may contradict its data."""
    header = f"{{'descr': {descr if descr[0] in '([' else repr(descr)}, 'fortran_order': False, 'shape': {shape}, }}\n"
    length = struct.pack("<H" if version == 1 else "<I", len(header))
    return b"\x93NUMPY" + bytes([version, 0]) + length + header.encode() + data


def archive(path, content: dict[str, bytes], compression: int = zipfile.ZIP_STORED) -> None:
    with zipfile.ZipFile(path, "w", compression) as out:
        for name, data in content.items():
            out.writestr(f"{name}.npy", data)


HOSTILE = {
    "terabytes": ({"points": column("(1000000000000, 3, 3)")}, r"'points' of shape .* takes 72,000,000,000,000 bytes"),
    "more than 64 bits": ({"points": column("(4611686018427387904, 3, 3)")}, r"'points' of shape .* takes 332,041"),
    "grasps without bytes": (
        {"points": column("(1000000000000, 0, 3)"), "normals": column("(1000000000000, 0, 3)")},
        r"points has shape \(1000000000000, 0, 3\): expected at least one contact",
    ),
    "negative": ({"friction": column("(-8,)")}, r"'friction' has shape \(-8,\): expected sizes of 0 or more"),
    "two negative": ({"friction": column("(-2, -4)", data=bytes(64))}, r"'friction' has shape \(-2, -4\)"),
    "large text": ({"name": column("(2,)", "<U300000000")}, r"'name' of shape \(2,\) .* takes 2,400,000,000 bytes"),
    "long text": ({"name": np.array(["a", "b" * 1_001])}, r"name holds text of 1,001 characters: expected 1 to"),
    "empty text": ({"name": column("(2,)", "<U0", data=b"")}, r"name holds text of 0 characters: expected 1 to"),
    "no text": ({"name": np.array([1, 2])}, r"name holds int64: expected text"),
    "structured text": (
        {"name": np.zeros(2, [("a", "U3"), ("b", "f8")])},
        r"name holds \[\('a', '<U3'\), \('b', '<f8'\)\]: expected text",
    ),
    "structured numbers": ({"friction": np.zeros(8, [("a", "f8")])}, r"friction holds \[\('a', '<f8'\)\]"),
    "complex": ({"friction": np.ones(8, complex)}, r"friction holds complex128: expected numbers"),
    "true": ({"friction": np.ones(8, bool)}, r"friction holds bool: expected numbers"),
    "other bytes": ({"name": np.array([b"a", b"\xff"])}, r"name holds bytes that are not UTF-8"),
    "version of terabytes": ({"version": column("(1000000000000,)", "<i8")}, r"'version' of shape .* takes 8,000,000"),
    "no Unicode": ({"name": column("(2,)", "<U1", data=b"\xff" * 8)}, r"name holds characters that are not Unicode"),
    "durations": ({"friction": np.ones(8, "m8[s]")}, r"friction holds timedelta64\[s\]: expected numbers"),
    "wide numbers": (
        {"friction": np.ones(8, np.longdouble)},
        r"friction holds float128: expected numbers of at most 64",
    ),
    "offsets of durations": ({"offsets": np.array([0, 4, 8], "m8[s]")}, r"offsets holds timedelta64\[s\]"),
    "version of durations": ({"version": np.array(1, "m8[s]")}, r"version is timedelta64\[s\] of shape"),
    "wrenches without end": (
        {"wrench": np.zeros((2, 100_001, 6), "f2")},
        r"a grasp has 100,001 wrenches: expected at most 100,000",
    ),
    "version of text": ({"version": np.array("1")}, r"version is <U1 of shape \(\): expected the integer 1"),
    "junk header": ({"friction": b"\x93NUMPY\x01\x00\x04\x00{{{{"}, r"'friction' cannot be read"),
    "header of gigabytes": ({"friction": b"\x93NUMPY\x02\x00" + struct.pack("<I", 1 << 31)}, r"'friction' cannot"),
    "deep header": ({"friction": column("(" * 5_000 + ")" * 5_000)}, r"'friction' cannot be read"),
    "unknown version": ({"friction": column("(8,)", version=9)}, r"'friction' cannot be read \(NPY version \(9, 0\)\)"),
    "more than it says": ({"friction": column("(8,)", data=bytes(72))}, r"takes 64 bytes and has 72: expected no more"),
}


@pytest.mark.parametrize("kind", HOSTILE)
@pytest.mark.filterwarnings("ignore:Reading `.npy` or `.npz` file required additional header parsing")
def test_a_hostile_column_is_refused_by_name(folder, kind):
    changes, message = HOSTILE[kind]
    raw = {}
    for name, value in changes.items():
        raw[name] = value if isinstance(value, bytes) else _bytes(value)
    content = members(**raw)
    if kind == "grasps without bytes":
        del content["offsets"]
    archive("set.npz", content)
    with pytest.raises(jaxgrasp.GraspFileError, match=message) as caught:
        jaxgrasp.load_grasps("set.npz")
    assert str(caught.value).startswith("set.npz: ")


def _bytes(array: np.ndarray) -> bytes:
    stream = io.BytesIO()
    np.lib.format.write_array(stream, array)
    return stream.getvalue()


def test_bytes_are_read_as_text(folder):
    archive("set.npz", members(name=_bytes(np.array(["é".encode(), b"b"]))))
    assert jaxgrasp.load_grasps("set.npz").labels["name"].tolist() == ["é", "b"]


def test_a_column_that_comes_twice_is_refused(folder):
    archive("set.npz", members())
    with pytest.warns(UserWarning, match="Duplicate name"), zipfile.ZipFile("set.npz", "a") as out:
        out.writestr("friction.npy", members()["friction"])
    with pytest.raises(jaxgrasp.GraspFileError, match="it has the column 'friction' twice"):
        jaxgrasp.load_grasps("set.npz")


def test_sizes_that_compression_cannot_reach_are_refused(folder):
    """A directory that claims 72 TB for some bytes, as the header does too."""
    shape = "(1000000000000, 3, 3)"
    archive("set.npz", members(points=column(shape)), zipfile.ZIP_DEFLATED)
    data = (folder / "set.npz").read_bytes()
    at = data.rindex(b"PK\x01\x02", 0, data.rindex(b"points.npy"))
    claimed = len(column(shape)) + 4_000_000_000
    forged = data[: at + 24] + struct.pack("<I", claimed) + data[at + 28 :]
    (folder / "set.npz").write_bytes(forged.replace(b"(1000000000000, 3, 3)", b"(500000000,)".ljust(21)))
    with pytest.raises(jaxgrasp.GraspFileError, match=r"'points'"):
        jaxgrasp.load_grasps("set.npz")


def test_other_compressions_are_refused(folder):
    archive("set.npz", members(), zipfile.ZIP_LZMA)
    with pytest.raises(jaxgrasp.GraspFileError, match="another method than deflate"):
        jaxgrasp.load_grasps("set.npz")


@pytest.mark.parametrize("number", ["1_0", "١٢", "1e", "0x10", "1 0", "", "²", "1,5", "1.0\u00a0", "--1", "1e1_0"])
def test_numbers_in_csv_are_ascii_decimals(folder, number):
    cell = f'"{number}"' if "," in number else number
    (folder / "set.csv").write_text(CSV + ROW.replace("0.5", cell))
    with pytest.raises(jaxgrasp.GraspFileError, match="line 2, column friction is .*: expected a number"):
        jaxgrasp.load_grasps("set.csv")


@pytest.mark.parametrize("number", ["0.5", ".5", "5e-1", "+0.5", "5.E-1", " 0.5 ", "0.500"])
def test_every_usual_way_to_write_a_number_is_read(folder, number):
    (folder / "set.csv").write_text(CSV + ROW.replace("0.5", number))
    assert jaxgrasp.load_grasps("set.csv").friction.tolist() == [0.5]


@pytest.mark.parametrize("number", ["nan", "NaN", "inf", "-Infinity"])
def test_numbers_that_are_not_finite_are_faults_of_the_data(folder, number):
    (folder / "set.csv").write_text(CSV + ROW.replace("0.5", number))
    with pytest.raises(jaxgrasp.GraspError, match=r"friction\[0, 0\]"):
        jaxgrasp.load_grasps("set.csv")


def test_long_text_in_csv_is_refused(folder):
    (folder / "set.csv").write_text(CSV.strip() + ",name\n" + ROW.strip() + "," + "x" * 1_001 + "\n")
    with pytest.raises(jaxgrasp.GraspFileError, match="line 2, column name is text of 1,001 characters"):
        jaxgrasp.load_grasps("set.csv")


def test_long_text_is_not_written(folder):
    with pytest.raises(ValueError, match=r"name\[1\] is text of 1,001 characters: expected at most 1,000"):
        jaxgrasp.save_grasps("set.npz", make_sets([3, 5]), name=["a", "x" * 1_001])
    assert not list(folder.iterdir())


ESCAPES = "\x1b[2J\x1b]0;title\x07\r\x00\x9b31m\u202e\nfaked line"


def unharmed(text: str) -> None:
    """Check that the text cannot act on a terminal, and that no line of it is forged."""
    assert all(c == "\n" or c.isprintable() for c in text), text
    assert not any(line.startswith("faked") for line in text.splitlines())


@pytest.mark.parametrize("suffix", ["npz", "csv"])
def test_info_and_validate_show_control_characters_escaped(folder, capsys, suffix):
    text = ESCAPES if suffix == "npz" else ESCAPES.replace("\r", "")
    jaxgrasp.save_grasps(f"set.{suffix}", make_sets([3, 5]), name=[text, "b"], object=["o", text])
    assert main(["info", f"set.{suffix}"]) == 0
    assert main(["validate", f"set.{suffix}"]) == 0
    shown = capsys.readouterr()
    unharmed(shown.out + shown.err)
    assert r"\x1b[2J\x1b]0;title\x07" in shown.out


def test_errors_show_control_characters_escaped(folder, capsys):
    archive("set.npz", {ESCAPES.replace("\x00", ""): b""})
    (folder / "bad\x1b[2J.csv").write_text(CSV + ROW.replace("0.5", "\x1b[2J"))
    for name in ("set.npz", "bad\x1b[2J.csv", "nowhere\x1b[2J\nfaked.npz"):
        assert main(["info", name]) == 1
        shown = capsys.readouterr().err
        unharmed(shown)
        assert shown.count("\n") == 1


@pytest.mark.slow
def test_hostile_text_passes_through_an_evaluation(folder, capsys):
    jaxgrasp.save_grasps("set.npz", make_sets([3, 3]), name=[ESCAPES, "<script>"])
    assert main(["evaluate", "set.npz", "--out", "out\x1b[2J", "--no-report"]) == 0
    shown = capsys.readouterr()
    unharmed(shown.out + shown.err)


@pytest.mark.parametrize("column_of", ["grasp", "offsets", "B.forces"])
def test_a_hostile_shard_is_computed_again(folder, capsys, column_of):
    jaxgrasp.save_grasps("set.npz", make_sets([3, 3]))
    run = ["evaluate", "set.npz", "--out", "out", "--no-report", "--methods", "B"]
    assert main(run) == 0
    good = (folder / "out" / "results.npz").read_bytes()
    with zipfile.ZipFile(io.BytesIO(good)) as old, zipfile.ZipFile(folder / "out" / "results.npz", "w") as new:
        for name in old.namelist():
            lie = column("(1000000000000, 3, 3)") if name == f"{column_of}.npy" else old.read(name)
            new.writestr(name, lie)
    assert main([*run, "--resume"]) == 0
    assert "computed again" in capsys.readouterr().err
    with np.load(folder / "out" / "results.npz") as computed, np.load(io.BytesIO(good)) as expected:
        for name in expected.files:
            np.testing.assert_array_equal(computed[name], expected[name])


def test_a_manifest_of_any_depth_is_refused(folder, capsys):
    jaxgrasp.save_grasps("set.npz", make_sets([3, 3]))
    (folder / "out").mkdir()
    for junk in ("[" * 100_000, '{"a":' * 100_000, "null", json.dumps({"complete": True, "shards": 3})):
        (folder / "out" / "manifest.json").write_text(junk)
        assert main(["evaluate", "set.npz", "--out", "out", "--no-report"]) == 1
        assert "not written by jaxgrasp evaluate" in capsys.readouterr().err


def test_no_hostile_file_takes_memory(folder):
    """All of them in one process that may not have two gigabytes more than it starts with."""
    for kind, (changes, _) in HOSTILE.items():
        raw = {name: value if isinstance(value, bytes) else _bytes(value) for name, value in changes.items()}
        archive(f"{kind}.npz", members(**raw))
    code = (
        "import resource, sys, warnings, jaxgrasp\n"
        "warnings.simplefilter('ignore')\n"
        "used = int(open('/proc/self/statm').read().split()[0]) * resource.getpagesize()\n"
        f"resource.setrlimit(resource.RLIMIT_AS, (used + {LARGE},) * 2)\n"
        "for name in sys.argv[1:]:\n"
        "    try:\n"
        "        jaxgrasp.load_grasps(name)\n"
        "    except jaxgrasp.GraspFileError:\n"
        "        continue\n"
        "    sys.exit(f'{name} was read')\n"
    )
    if not sys.platform.startswith("linux"):
        pytest.skip("the limit on memory is read where Linux keeps it")
    names = [f"{kind}.npz" for kind in HOSTILE]
    done = subprocess.run([sys.executable, "-c", code, *names], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
