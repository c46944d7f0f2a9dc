"""Results on disk: one file a chunk and a manifest, so that an interrupt costs only the chunks in work.

A shard holds, for each method, ``METHOD.forces (M, W, 3)``, ``.verdict``, ``.residual``, ``.objective``,
``.steps``, ``.route``, ``.margin``, ``.violation (N, W)`` and for optima ``.certificate (N, W, 6)``; with soft
fingers ``.moments (M, W)``; of limited optima ``.normal_multiplier (M, W)``, ``.torque_multiplier`` and
``.certificate_rates (N, W, j)``; and ``grasp (N,)``, the grasps' numbers in the input, and ``offsets (N + 1,)`` of
its contacts; and for each measure of quality that was asked for, columns ``quality.MEASURE.COLUMN (N,)``.
"""

import json
import os
import re
from dataclasses import fields
from pathlib import Path

import numpy as np

from jaxgrasp.batch.engine import MethodResult
from jaxgrasp.batch.file_error import GraspFileError
from jaxgrasp.batch.npz_file import save_arrays
from jaxgrasp.files.replace import replace_file

MANIFEST = "manifest.json"
VERSION = 4
OURS = re.compile(r"shard-\d{5}\.npz|results\.npz")
PARTIAL = re.compile(r"\.(shard-\d{5}\.npz|results\.npz|manifest\.json)\.\d+\.partial")
BESIDE = ("summary.json", "report.html")
"""What the command line writes beside the results, and what is stale without them."""
SMALL = 64 << 20
"""Results up to this many bytes end as one file instead of shards."""


class ResultFolder:
    """The output folder of one evaluation."""

    def __init__(self, folder: Path, identity: dict, resume: bool):
        """Open ``folder`` for the evaluation that ``identity`` describes.

        Raises:
            GraspFileError: if it cannot be written, holds results already, or those of another evaluation
                when told to resume.
        """
        self.folder = folder
        try:
            folder.mkdir(parents=True, exist_ok=True)
            probe = folder / f".probe.{os.getpid()}"
            probe.touch()
            probe.unlink()
        except OSError as error:
            raise GraspFileError(folder, f"the output folder cannot be written ({error.strerror})") from error
        self._earlier: dict | None = None
        self.manifest: dict = {"version": VERSION, **identity, "shards": [], "summary": None, "complete": False}
        if (folder / MANIFEST).exists():
            self._take_up(identity, resume)
        elif unknown := [path.name for path in folder.iterdir() if OURS.fullmatch(path.name)]:
            raise GraspFileError(folder, f"it holds {unknown[0]} of unknown origin: choose another --out, or move it")

    def _take_up(self, identity: dict, resume: bool) -> None:
        try:
            found = json.loads((self.folder / MANIFEST).read_text())
            complete, entries = found["complete"], found["shards"]
            files = [entry["file"] for entry in entries]
        except (ValueError, KeyError, TypeError) as error:
            raise GraspFileError(self.folder, f"its {MANIFEST} is not one of ours ({error})") from error
        if not all(OURS.fullmatch(name) for name in files):
            raise GraspFileError(self.folder, f"its {MANIFEST} names files that are not ours")
        if not resume:
            if not complete and entries:
                raise GraspFileError(
                    self.folder, "it holds an unfinished evaluation: --resume goes on with it, or choose another --out"
                )
            self._earlier = found
            return
        named = ("version", *identity)
        differing = [key for key in named if found.get(key) != self.manifest[key]]
        if differing:
            key = differing[0]
            raise GraspFileError(
                self.folder,
                f"its results have {key} = {found.get(key)!r}, not {identity[key]!r}: they cannot be resumed",
            )
        self.manifest = found

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
        replace_file(self.folder / name, lambda stream: save_arrays(stream, arrays))
        self.manifest["shards"].append({"file": name, "start": start, "stop": stop})
        self.manifest["summary"] = summary
        self._write_manifest()

    def finish(self) -> None:
        """Join small shards into ``results.npz`` and mark the evaluation complete."""
        if self.manifest["complete"]:
            return
        entries = self.manifest["shards"]
        paths = [self.folder / entry["file"] for entry in entries]
        if sum(path.stat().st_size for path in paths) <= SMALL:
            joined = _joined(paths)
            replace_file(self.folder / "results.npz", lambda stream: save_arrays(stream, joined))
            self.manifest["shards"] = [{"file": "results.npz", "start": 0, "stop": self.done}]
        else:
            paths = []
        self.manifest["complete"] = True
        self._write_manifest()
        for path in paths:
            path.unlink()

    def _write_manifest(self) -> None:
        text = json.dumps(self.manifest).encode()
        replace_file(self.folder / MANIFEST, lambda stream: stream.write(text))


def arrays_of(
    results: dict[str, MethodResult],
    offsets: np.ndarray,
    grasp: np.ndarray,
    constrained: set[str],
    quality: dict[str, np.ndarray],
) -> dict:
    """A chunk's results as the arrays of a shard."""
    arrays = {"grasp": grasp, "offsets": offsets}
    for method, result in results.items():
        for field in fields(MethodResult):
            array = getattr(result, field.name)
            if array is not None and (field.name != "certificate" or method in constrained):
                arrays[f"{method}.{field.name}"] = array
    return arrays | {f"quality.{name}": column for name, column in quality.items()}


def _joined(paths: list[Path]) -> dict[str, np.ndarray]:
    shards = [dict(np.load(path, allow_pickle=False)) for path in paths]
    joined = {name: np.concatenate([shard[name] for shard in shards]) for name in shards[0] if name != "offsets"}
    sizes = np.concatenate([np.diff(shard["offsets"]) for shard in shards])
    return {"offsets": np.concatenate([[0], np.cumsum(sizes)]), **joined}
