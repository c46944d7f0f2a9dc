"""Results on disk: a file for each chunk and a manifest, so that an interrupt costs only the chunks in work.

A shard holds, for each method, ``METHOD.forces (M, W, 3)``, ``.verdict``, ``.residual``, ``.objective``,
``.steps``, ``.route``, ``.margin``, ``.violation (N, W)`` and for optima ``.certificate (N, W, 6)`` and
``.force_bound (N, W)``; with soft fingers ``.moments (M, W)``; of limited optima ``.normal_multiplier (M, W)``,
``.torque_multiplier`` and ``.certificate_rates (N, W, j)``; and ``grasp (N,)``, the grasps' numbers in the input, and
``offsets (N + 1,)`` of its contacts; ``why (N, W)``, codes of [`Reason`][jaxgrasp.batch.reasons.Reason]; the grasps'
own ``name (N,)`` where they have one; ``squeeze_factor (N, W)``; ``least_friction (N, W)`` where it was asked for; and
for each measure of quality that was asked for, columns ``quality.MEASURE.COLUMN (N,)``.

The manifest holds the identity of the evaluation, and a checksum of each file. The checksum of grasps' names does not
depend on their order, and differs if names are lost or doubled.
"""

import hashlib
import json
import re
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import fields
from pathlib import Path

import numpy as np

from jaxgrasp.batch.contact_sets import ContactSets
from jaxgrasp.batch.engine import MethodResult
from jaxgrasp.batch.file_error import GraspFileError
from jaxgrasp.batch.npz_file import save_arrays
from jaxgrasp.files.printable import printable, shortened
from jaxgrasp.files.replace import FolderHeldError, locked, partial_target, replace_file
from jaxgrasp.model.solution import METHODS

MODULUS = 1 << 64
_STEP = 0x9E3779B97F4A7C15
_MIXERS = ((np.uint64(30), np.uint64(0xBF58476D1CE4E5B9)), (np.uint64(27), np.uint64(0x94D049BB133111EB)))
"""Shifts and factors of SplitMix64 (Steele, Lea & Flood 2014), which spreads each bit of a number over all of it."""


def names_checksum(names: np.ndarray) -> int:
    """Compute the sum, modulo 2^64, of a hash of each text ``(N,)``."""
    texts = np.ascontiguousarray(names.astype(str))
    if not len(texts) or not texts.dtype.itemsize:
        return len(texts)
    codes = texts.view(np.uint32).reshape(len(texts), -1)
    numbers = np.full(len(texts), _STEP, np.uint64)
    for position, column in enumerate(codes.T):
        # A text is followed by zeros up to the longest one's length: these must not count.
        mixed = _mixed(column.astype(np.uint64) + np.uint64((position + 1) * _STEP % MODULUS))
        numbers += np.where(column, mixed, np.uint64(0))
    return int(np.sum(_mixed(numbers), dtype=np.uint64))


def _mixed(numbers: np.ndarray) -> np.ndarray:
    for shift, factor in _MIXERS:
        numbers = (numbers ^ (numbers >> shift)) * factor
    return numbers ^ (numbers >> np.uint64(31))


MANIFEST = "manifest.json"
VERSION = 8


@contextmanager
def held_folder(folder: Path, announce: Callable[[str], None] = lambda text: None) -> Iterator[None]:
    """Make an output folder and hold it against other processes until the block ends.

    Raises:
        GraspFileError: if it cannot be written, or another process works in it.
    """
    make_folder(folder)
    with ExitStack() as stack:
        try:
            stack.enter_context(locked(folder, announce))
        except FolderHeldError as error:
            raise GraspFileError(folder, f"{error}: wait for it, or choose another --out") from error
        except OSError as error:
            raise _unwritable(folder, error) from error
        yield


def make_folder(folder: Path) -> None:
    """Make an output folder where there is none.

    Raises:
        GraspFileError: if it cannot be made.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise _unwritable(folder, error) from error


def _unwritable(folder: Path, error: OSError) -> GraspFileError:
    return GraspFileError(folder, f"the output folder cannot be written ({error.strerror})")


class Manifest:
    """Manifest of a folder of results: ``content``, with an entry for each file in ``shards``."""

    def __init__(
        self,
        folder: Path,
        identity: dict,
        result_names: re.Pattern[str],
        resume: bool,
        overwrite: bool = False,
        is_claimed: Callable[[str], object] | None = None,
    ):
        """Read the manifest of ``folder``, or begin one for the evaluation that ``identity`` describes.

        A finished evaluation of the same input by the same options may be done again; one of others gives way only
        with ``overwrite``. ``result_names`` matches the names that results may have; ``is_claimed`` tells which
        existing files have the name of a result, all that match ``result_names`` where not given.

        Raises:
            GraspFileError: if the folder cannot be made, holds results already, or those of another evaluation when
                told to resume.
        """
        self.folder, self._result_names = folder, result_names
        make_folder(folder)
        self.earlier: dict | None = None
        self.content: dict = {"version": VERSION, **identity, "shards": [], "summary": None, "complete": False}
        if (folder / MANIFEST).exists():
            self._take_up(identity, resume, overwrite)
        elif unknown := [path.name for path in folder.iterdir() if (is_claimed or result_names.fullmatch)(path.name)]:
            raise GraspFileError(folder, f"it holds {unknown[0]} of unknown origin: choose another --out, or move it")

    def _take_up(self, identity: dict, resume: bool, overwrite: bool) -> None:
        try:
            earlier = json.loads((self.folder / MANIFEST).read_text())
            complete, entries = earlier["complete"], earlier["shards"]
            files = [entry["file"] for entry in entries]
        except (ValueError, KeyError, TypeError, RecursionError, OSError) as error:
            raise GraspFileError(
                self.folder, f"its {MANIFEST} was not written by jaxgrasp evaluate ({error})"
            ) from error
        if earlier.pop("sha256", None) != _sealed(earlier) and earlier.get("version") == VERSION:
            raise GraspFileError(self.folder, f"its {MANIFEST} was changed after jaxgrasp wrote it")
        if not all(self._result_names.fullmatch(str(name)) for name in files):
            raise GraspFileError(self.folder, f"its {MANIFEST} names files that jaxgrasp evaluate does not write")
        differing = [key for key in ("version", *identity) if earlier.get(key) != self.content[key]]
        if resume:
            if differing:
                raise GraspFileError(
                    self.folder,
                    f"{self._mismatch(earlier, differing[0])}: they cannot be resumed; "
                    "--overwrite in place of --resume drops them, or choose another --out",
                )
            self.content = earlier
            return
        if not overwrite and not complete and entries:
            raise GraspFileError(
                self.folder,
                "it holds an unfinished evaluation: --resume goes on with it, --overwrite drops it; "
                "or choose another --out",
            )
        if not overwrite and differing and entries:
            raise GraspFileError(
                self.folder, f"{self._mismatch(earlier, differing[0])}: add --overwrite, or choose another --out"
            )
        self.earlier = earlier

    def _mismatch(self, earlier: dict, key: str) -> str:
        """Describe the difference ``key`` between the folder's results and the wanted ones, as part of a message."""
        if key == "fingerprint":
            return f"{printable(self.content.get('input'))} has changed since these results were written"
        if key == "input":
            return f"its results are of {shortened(earlier.get(key))}, not of {shortened(self.content[key])}"
        return f"its results have {key} = {shortened(earlier.get(key))}, not {shortened(self.content[key])}"

    def drop_earlier(self, beside: tuple[str, ...]) -> None:
        """Remove an earlier evaluation that gives way, with what stands ``beside`` its results."""
        if self.earlier:
            for name in (*(entry["file"] for entry in self.earlier["shards"]), *beside):
                (self.folder / name).unlink(missing_ok=True)

    def drop_partial(self) -> None:
        """Remove partial files of results and of the manifest, which processes that were killed left behind."""
        for path in self.folder.iterdir():
            target = partial_target(path.name)
            if target is not None and (target == MANIFEST or self._result_names.fullmatch(target)):
                path.unlink(missing_ok=True)

    def write(self) -> None:
        """Write the manifest with its SHA-256, whole or not at all."""
        text = json.dumps(self.content | {"sha256": _sealed(self.content)}).encode()
        replace_file(self.folder / MANIFEST, lambda stream: stream.write(text))


def _sealed(manifest: dict) -> str:
    """Compute the SHA-256 of a manifest, which shows whether it was edited after it was written."""
    return hashlib.sha256(json.dumps(manifest, sort_keys=True).encode()).hexdigest()


def hashed(path: Path) -> str:
    """Compute the SHA-256 of a file, in hexadecimal digits."""
    with open(path, "rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def is_whole(path: Path, entry: dict) -> bool:
    """Check that a file exists and has the SHA-256 of its manifest entry."""
    try:
        return path.is_file() and hashed(path) == entry.get("sha256")
    except OSError:
        return False


RESULT_NAMES = re.compile(r"shard-\d{5}\.npz|results\.npz")
BESIDE = ("summary.json", "report.html", "results.csv", "results.parquet")
"""Files that the command line writes beside the results, and that are stale without them."""
SMALL = 64 << 20
"""Results up to this many bytes end as one file instead of shards."""


class ResultFolder:
    """The output folder of one evaluation, to be held (``held_folder``) while it is open."""

    def __init__(self, folder: Path, identity: dict, resume: bool, overwrite: bool = False):
        """Open ``folder``, made where it is not there, for the evaluation that ``identity`` describes.

        A finished evaluation of the same input by the same options may be done again; one of others gives way only
        with ``overwrite``.

        Raises:
            GraspFileError: if it cannot be made, holds results already, or those of another evaluation when told to
                resume.
        """
        self.folder = folder
        self._file = Manifest(folder, identity, RESULT_NAMES, resume, overwrite)

    @property
    def manifest(self) -> dict:
        """Contents of the manifest."""
        return self._file.content

    def damaged(self) -> list[dict]:
        """Return the manifest entries whose files are missing, cut short or changed; all bytes are read."""
        return [entry for entry in self.manifest["shards"] if not is_whole(self.folder / entry["file"], entry)]

    def replace(self, entry: dict, arrays: dict[str, np.ndarray]) -> None:
        """Write a damaged shard anew."""
        entry["sha256"] = self._save(entry["file"], arrays)
        self._file.write()

    def start_over(self) -> None:
        """Forget all shards, so that everything is computed again."""
        self._file.content |= {"shards": [], "summary": None, "complete": False}

    def begin(self) -> None:
        """Make room: remove an earlier, finished evaluation and leftovers of an interrupt, and nothing else."""
        self._file.drop_earlier(BESIDE)
        named = {entry["file"] for entry in self.manifest["shards"]}
        for path in self.folder.iterdir():
            if RESULT_NAMES.fullmatch(path.name) and path.name not in named:
                path.unlink()
        self._file.drop_partial()
        self._file.write()

    @property
    def done(self) -> int:
        """Grasps of the input whose results are on disk."""
        return self.manifest["shards"][-1]["stop"] if self.manifest["shards"] else 0

    @property
    def summary(self) -> dict | None:
        """Summary of all results on disk."""
        return self.manifest["summary"]

    def add(self, arrays: dict[str, np.ndarray], start: int, stop: int, summary: dict) -> None:
        """Write one chunk's results; the manifest names a shard only once it is whole.

        ``summary`` is that of all chunks so far.
        """
        name = f"shard-{len(self.manifest['shards']):05d}.npz"
        sha256 = self._save(name, arrays)
        self.manifest["shards"].append({"file": name, "start": start, "stop": stop, "sha256": sha256})
        self.manifest["summary"] = summary
        self._file.write()

    def shards(self) -> Iterator[dict[str, np.ndarray]]:
        """Yield the arrays of each shard, in the order of the input."""
        for entry in self.manifest["shards"]:
            with np.load(self.folder / entry["file"], allow_pickle=False) as arrays:
                yield dict(arrays)

    def finish(self) -> None:
        """Join small shards into ``results.npz`` and mark the evaluation complete."""
        if self.manifest["complete"]:
            return
        entries = self.manifest["shards"]
        paths = [self.folder / entry["file"] for entry in entries]
        if sum(path.stat().st_size for path in paths) <= SMALL:
            joined = _joined(paths)
            sha256 = self._save("results.npz", joined)
            self.manifest["shards"] = [{"file": "results.npz", "start": 0, "stop": self.done, "sha256": sha256}]
        else:
            paths = []
        self.manifest["complete"] = True
        self._file.write()
        for path in paths:
            path.unlink()

    def _save(self, name: str, arrays: dict[str, np.ndarray]) -> str:
        """Write a shard and return its SHA-256."""
        replace_file(self.folder / name, lambda stream: save_arrays(stream, arrays))
        return hashed(self.folder / name)


def arrays_of(
    sets: ContactSets,
    results: dict[str, MethodResult],
    why: np.ndarray,
    numbers: np.ndarray,
    quality: dict[str, np.ndarray],
    least_friction: np.ndarray | None = None,
    squeeze_factor: np.ndarray | None = None,
) -> dict[str, np.ndarray]:
    """Return the results of sets as the arrays of a shard; ``numbers (N,)`` are those of the grasps in the input."""
    arrays = {"grasp": numbers, "offsets": sets.offsets, "why": why}
    if "name" in sets.labels:
        arrays["name"] = np.asarray(sets.labels["name"], str)
    if least_friction is not None:
        arrays["least_friction"] = least_friction
    if squeeze_factor is not None:
        arrays["squeeze_factor"] = squeeze_factor
    for method, result in results.items():
        for field in fields(MethodResult):
            array = getattr(result, field.name)
            if array is not None and (field.name not in ("certificate", "force_bound") or METHODS[method].constrained):
                arrays[f"{method}.{field.name}"] = array
    return arrays | {f"quality.{name}": column for name, column in quality.items()}


def _joined(paths: list[Path]) -> dict[str, np.ndarray]:
    shards = [dict(np.load(path, allow_pickle=False)) for path in paths]
    joined = {name: np.concatenate([shard[name] for shard in shards]) for name in shards[0] if name != "offsets"}
    sizes = np.concatenate([np.diff(shard["offsets"]) for shard in shards])
    return {"offsets": np.concatenate([[0], np.cumsum(sizes)]), **joined}
