"""Results on disk: one file a chunk and a manifest, so that an interrupt costs only the chunks in work.

A shard holds, for each method, ``METHOD.forces (M, W, 3)``, ``.verdict``, ``.residual``, ``.objective``,
``.steps``, ``.route``, ``.margin``, ``.violation (N, W)`` and for optima ``.certificate (N, W, 6)`` and
``.force_bound (N, W)``; with soft fingers ``.moments (M, W)``; of limited optima ``.normal_multiplier (M, W)``,
``.torque_multiplier`` and ``.certificate_rates (N, W, j)``; and ``grasp (N,)``, the grasps' numbers in the input, and
``offsets (N + 1,)`` of its contacts; ``why (N, W)``, codes of [`Reason`][jaxgrasp.batch.reasons.Reason]; the grasps'
own ``name (N,)`` where they have one; ``least_friction (N, W)`` where it was asked for; and for each measure of quality
that was asked for, columns ``quality.MEASURE.COLUMN (N,)``.
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
from jaxgrasp.files.lock import FolderHeldError, locked
from jaxgrasp.files.printable import shortened
from jaxgrasp.files.replace import replace_file
from jaxgrasp.model.compared_methods import METHODS

MANIFEST = "manifest.json"
VERSION = 7
OURS = re.compile(r"shard-\d{5}\.npz|results\.npz")
PARTIAL = re.compile(r"\.(shard-\d{5}\.npz|results\.npz|manifest\.json)\.\d+\.partial")
BESIDE = ("summary.json", "report.html", "results.csv", "results.parquet")
"""What the command line writes beside the results, and what is stale without them."""
SMALL = 64 << 20
"""Results up to this many bytes end as one file instead of shards."""


@contextmanager
def held_folder(folder: Path, announce: Callable[[str], None] = lambda text: None) -> Iterator[None]:
    """Make an output folder and hold it against other processes until the block ends.

    Raises:
        GraspFileError: if it cannot be written, or another process works in it.
    """
    _make(folder)
    with ExitStack() as stack:
        try:
            stack.enter_context(locked(folder, announce))
        except FolderHeldError as error:
            raise GraspFileError(folder, f"{error}: wait for it, or choose another --out") from error
        except OSError as error:
            raise _unwritable(folder, error) from error
        yield


def _make(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise _unwritable(folder, error) from error


def _unwritable(folder: Path, error: OSError) -> GraspFileError:
    return GraspFileError(folder, f"the output folder cannot be written ({error.strerror})")


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
        _make(folder)
        self._earlier: dict | None = None
        self.manifest: dict = {"version": VERSION, **identity, "shards": [], "summary": None, "complete": False}
        if (folder / MANIFEST).exists():
            self._take_up(identity, resume, overwrite)
        elif unknown := [path.name for path in folder.iterdir() if OURS.fullmatch(path.name)]:
            raise GraspFileError(folder, f"it holds {unknown[0]} of unknown origin: choose another --out, or move it")

    def _take_up(self, identity: dict, resume: bool, overwrite: bool) -> None:
        try:
            found = json.loads((self.folder / MANIFEST).read_text())
            complete, entries = found["complete"], found["shards"]
            files = [entry["file"] for entry in entries]
        except (ValueError, KeyError, TypeError, RecursionError, OSError) as error:
            raise GraspFileError(self.folder, f"its {MANIFEST} is not one of ours ({error})") from error
        if found.pop("sha256", None) != _sealed(found) and found.get("version") == VERSION:
            raise GraspFileError(self.folder, f"its {MANIFEST} was changed since we wrote it")
        if not all(OURS.fullmatch(str(name)) for name in files):
            raise GraspFileError(self.folder, f"its {MANIFEST} names files that are not ours")
        differing = [key for key in ("version", *identity) if found.get(key) != self.manifest[key]]
        if resume:
            if differing:
                raise GraspFileError(self.folder, f"{self._unlike(found, differing[0])}: they cannot be resumed")
            self.manifest = found
            return
        if not overwrite and not complete and entries:
            raise GraspFileError(
                self.folder,
                "it holds an unfinished evaluation: --resume goes on with it, --overwrite drops it; "
                "or choose another --out",
            )
        if not overwrite and differing and entries:
            raise GraspFileError(
                self.folder, f"{self._unlike(found, differing[0])}: choose another --out, or --overwrite drops them"
            )
        self._earlier = found

    def _unlike(self, found: dict, key: str) -> str:
        """By what the results that are there differ from those that are wanted."""
        return f"its results have {key} = {shortened(found.get(key))}, not {shortened(self.manifest[key])}"

    def damaged(self) -> list[dict]:
        """Entries of the manifest whose files are missing, cut short or changed; all bytes are read."""
        return [entry for entry in self.manifest["shards"] if not _is_whole(self.folder / entry["file"], entry)]

    def replace(self, entry: dict, arrays: dict[str, np.ndarray]) -> None:
        """Write a damaged shard anew."""
        entry["sha256"] = self._save(entry["file"], arrays)
        self._write_manifest()

    def start_over(self) -> None:
        """Forget all shards, so that everything is computed again."""
        self.manifest |= {"shards": [], "summary": None, "complete": False}

    def begin(self) -> None:
        """Make room: remove an earlier, finished evaluation and leftovers of an interrupt, and nothing else."""
        if self._earlier:
            for name in (*(entry["file"] for entry in self._earlier["shards"]), *BESIDE):
                (self.folder / name).unlink(missing_ok=True)
        named = {entry["file"] for entry in self.manifest["shards"]}
        for path in self.folder.iterdir():
            if PARTIAL.fullmatch(path.name) or (OURS.fullmatch(path.name) and path.name not in named):
                path.unlink()
        self._write_manifest()

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
        self._write_manifest()

    def shards(self) -> Iterator[dict[str, np.ndarray]]:
        """The arrays of each shard, one after the other."""
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
        self._write_manifest()
        for path in paths:
            path.unlink()

    def _save(self, name: str, arrays: dict[str, np.ndarray]) -> str:
        """Write a shard, and return what it will be known by."""
        replace_file(self.folder / name, lambda stream: save_arrays(stream, arrays))
        return _hashed(self.folder / name)

    def _write_manifest(self) -> None:
        text = json.dumps(self.manifest | {"sha256": _sealed(self.manifest)}).encode()
        replace_file(self.folder / MANIFEST, lambda stream: stream.write(text))


def _sealed(manifest: dict) -> str:
    """What a manifest is known by: whoever edits one means other results than those beside it."""
    return hashlib.sha256(json.dumps(manifest, sort_keys=True).encode()).hexdigest()


def _hashed(path: Path) -> str:
    with open(path, "rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def _is_whole(path: Path, entry: dict) -> bool:
    """Whether a shard is the one that was written, to its last byte."""
    try:
        return path.is_file() and _hashed(path) == entry.get("sha256")
    except OSError:
        return False


def arrays_of(
    sets: ContactSets,
    results: dict[str, MethodResult],
    why: np.ndarray,
    numbers: np.ndarray,
    quality: dict[str, np.ndarray],
    least_friction: np.ndarray | None = None,
) -> dict[str, np.ndarray]:
    """The results of some sets as the arrays of a shard; ``numbers`` are the grasps' in the input."""
    arrays = {"grasp": numbers, "offsets": sets.offsets, "why": why}
    if "name" in sets.labels:
        arrays["name"] = np.asarray(sets.labels["name"], str)
    if least_friction is not None:
        arrays["least_friction"] = least_friction
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
