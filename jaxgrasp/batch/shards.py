"""Results on disk: a file for each chunk and a manifest, so that an interrupt costs only the chunks in work.

A shard holds, for each method, ``METHOD.forces (M, W, 3)``, ``.verdict``, ``.residual``, ``.objective``,
``.steps``, ``.route``, ``.margin``, ``.violation (N, W)`` and for optima ``.certificate (N, W, 6)`` and
``.force_bound (N, W)``; with soft fingers ``.moments (M, W)``; of limited optima ``.normal_multiplier (M, W)``,
``.torque_multiplier`` and ``.certificate_rates (N, W, j)``; and ``grasp (N,)``, the grasps' numbers in the input, and
``offsets (N + 1,)`` of its contacts; ``why (N, W)``, codes of [`Reason`][jaxgrasp.batch.reasons.Reason]; the grasps'
own ``name (N,)`` where they have one; ``squeeze_factor (N, W)``; ``least_friction (N, W)`` where it was asked for; and
for each measure of quality that was asked for, columns ``quality.MEASURE.COLUMN (N,)``.
"""

import re
from collections.abc import Iterator
from dataclasses import fields
from pathlib import Path

import numpy as np

from jaxgrasp.batch.contact_sets import ContactSets
from jaxgrasp.batch.engine import MethodResult
from jaxgrasp.batch.manifest import Manifest, hashed, is_whole
from jaxgrasp.batch.npz_file import save_arrays
from jaxgrasp.files.replace import replace_file
from jaxgrasp.model.compared_methods import METHODS

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
