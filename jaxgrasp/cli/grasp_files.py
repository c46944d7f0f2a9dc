"""Commands on files of grasps: ``convert``, ``template``, ``info``, ``validate``, ``rank`` and ``show``.

Commands that draw one grasp choose it here by its name or number.
"""

import difflib
from importlib.resources import files
from pathlib import Path
from typing import Protocol, runtime_checkable

import jax
import numpy as np

from jaxgrasp.batch.contact_sets import ContactSets
from jaxgrasp.batch.remote_file import RemoteFile
from jaxgrasp.batch.result_table import ranked_rows
from jaxgrasp.batch.sources import (
    MILLIMETRES,
    TURN_ROUND,
    Adjustments,
    GraspSource,
    OutwardNormals,
    file_format,
    looks_like_millimetres,
    numbered_chunks,
    open_source,
    outward_normals,
    save_grasps,
)
from jaxgrasp.cli.arguments import Convert, Data, Info, Rank, Show, Template, Validate
from jaxgrasp.cli.terminal import announce, show
from jaxgrasp.files.printable import printable, shortened
from jaxgrasp.files.replace import replace_file
from jaxgrasp.model.faults import GraspError

MOST_NAMES = 2_000
"""Names among which the nearest to an unknown one are looked for."""
SIMILAR, COVERED, NEAREST = 0.6, 0.7, 3
"""Least similarity, as difflib measures it; least share of a text that a longer name repeats; number of the names that
a message lists."""


class GraspQuery:
    """Name or number that a user gave, compared with the names of a file's grasps, which come in parts."""

    def __init__(self, query: str):
        self._query = query
        self._count = 0
        self._matches: list[int] = []
        self._names: list[str] = []

    def look(self, names: np.ndarray | None, count: int) -> None:
        """Compare with the next ``count`` grasps, of these names ``(count,)``, or None if they have none."""
        if names is not None:
            self._matches += (self._count + np.flatnonzero(names == self._query)).tolist()
            self._names += names[: MOST_NAMES - len(self._names)].tolist()
        self._count += count

    def number(self, file: str) -> int:
        """Return the number of the grasp of the wanted name, or else of that number.

        Raises:
            ValueError: naming the nearest names where there is no such grasp, and the numbers of several of that name.
        """
        if len(self._matches) > 1:
            listed = " and ".join(map(str, self._matches[:2]))
            raise ValueError(f"grasps {listed} are both named {shortened(self._query)}: give a number")
        if self._matches:
            return self._matches[0]
        is_number = self._query.isascii() and self._query.isdecimal()
        if is_number and int(self._query) < self._count:
            return int(self._query)
        range_ = f"a number from 0 to {self._count - 1}"
        expected = f": expected {range_}" if is_number or not self._names else self._nearest(range_)
        raise ValueError(f"{file} holds no grasp {shortened(self._query)}{expected}")

    def _nearest(self, range_: str) -> str:
        """Return the end of a message on an unknown name: the nearest names, or some names where none is near."""
        names = list(dict.fromkeys(self._names))
        query = self._query[:200]
        near = difflib.get_close_matches(query, names, NEAREST, SIMILAR)
        if not near:
            # Of names far longer than what was typed, none is similar as a whole.
            covered = sorted(((-_covered_share(query, name), k) for k, name in enumerate(names)))[:NEAREST]
            near = [names[k] for share, k in covered if -share >= COVERED]
        if near:
            *first, last = map(shortened, near)
            return f": did you mean {', '.join(first)}{' or ' if first else ''}{last}?"
        return f": expected a name, such as {', '.join(map(shortened, names[:NEAREST]))}, or {range_}"


def _covered_share(query: str, name: str) -> float:
    """Return the share of the query's characters that the name has in the same order, in pieces of 2 or more."""
    blocks = difflib.SequenceMatcher(None, query, name, autojunk=False).get_matching_blocks()
    return sum(block.size for block in blocks if block.size > 1) / max(1, len(query))


@runtime_checkable
class Conventions(Protocol):
    """Arguments that say how the grasps of a file differ from the conventions."""

    @property
    def normals(self) -> str: ...

    @property
    def normalize(self) -> bool: ...


SHIPPED = "simulated_grips.npz"


def data_path(file: "Path | RemoteFile | None") -> "Path | RemoteFile":
    """Return ``file``, or the path of the grasps that ship with the package where it is None."""
    return file or Path(str(files("jaxgrasp") / "data" / SHIPPED))


def adjustments_of(arguments: Conventions) -> Adjustments:
    """Return the changes to normals that bring the file's grasps to the conventions."""
    return Adjustments(arguments.normals == "outward", normalize=arguments.normalize)


def opened(data: Data, adjustments: Adjustments) -> GraspSource:
    """Open the file of grasps that the arguments name, for a ``with`` block."""
    return open_source(data_path(data.file), adjustments)


def convert_command(arguments: Convert) -> int:
    """Read all, check all, write all."""
    file_format(arguments.out)
    _check_free(arguments.out, arguments.overwrite, "; --overwrite replaces it")
    adjustments = adjustments_of(arguments)
    with open_source(arguments.file, adjustments) as source:
        sets = adjustments.apply(next(source.chunks(max(1, len(source)))))
        for fault in sets.faults():
            raise ValueError(f"{arguments.file}: {fault}")
        save_grasps(arguments.out, sets)
    show(f"{arguments.out}: {len(sets):,} grasps, {len(sets.points):,} contacts")
    return 0


def template_command(arguments: Template) -> int:
    """Write the example that ships with the package."""
    _check_free(arguments.out, False, ": choose another --out")
    content = (files("jaxgrasp") / "data" / f"template.{arguments.kind}").read_bytes()
    replace_file(arguments.out, lambda stream: stream.write(content))
    show(f"{arguments.out}: fill it in, then: jaxgrasp evaluate {arguments.out}")
    return 0


def _check_free(path: Path, overwrite: bool, remedy: str) -> None:
    if path.exists() and not overwrite:
        raise FileExistsError(f"{path} exists already{remedy}")


CHUNK = 65_536
UNITS = {
    "radius": "m",
    "friction": "",
    "squeeze": "N",
    "torsion": "m",
    "normal_min": "N",
    "normal_max": "N",
    "torque_max": "N.m",
    "force": "N",
    "torque": "N.m",
}


def info_command(arguments: Info) -> int:
    """Print counts, ranges and labels; reads the file once."""
    with opened(arguments, adjustments_of(arguments)) as source:
        chunks = [_facts(sets) for sets in source.chunks(CHUNK)]
        show(f"{data_path(arguments.file)}: {len(source):,} grasps, {source.wrenches} wrench(es) each")
    sizes = np.sum([np.bincount(facts["sizes"], minlength=source.largest + 1) for facts in chunks], 0)
    held = np.flatnonzero(sizes)
    show("contacts   " + ", ".join(f"{n}: {sizes[n]:,}" for n in held))
    for name, unit in UNITS.items():
        if name not in chunks[0]:
            continue
        low, high = min(f[name][0] for f in chunks), max(f[name][1] for f in chunks)
        if low > high:
            continue
        show(f"{name:10} {low:.4g} to {high:.4g} {unit}".rstrip())
    if joints := chunks[0]["joints"]:
        show(f"joints     {joints:,}")
    for label in chunks[0]["labels"]:
        values = np.unique(np.concatenate([facts["labels"][label] for facts in chunks]))
        text = ", ".join(map(printable, values[:8])) + (f", ... ({len(values):,} different)" if len(values) > 8 else "")
        show(f"{label:10} {text}")
    if any(facts["millimetres"] for facts in chunks):
        show(f"warning: {MILLIMETRES}")
    return 0


def validate_command(arguments: Validate) -> int:
    """Print warnings, every fault, and their number."""
    adjustments = adjustments_of(arguments)
    normals, in_millimetres = OutwardNormals(), False
    with opened(arguments, adjustments) as source:
        for first, raw in numbered_chunks(source, CHUNK):
            sets = adjustments.apply(raw)
            normals = normals.merged(outward_normals(sets, first + np.arange(len(sets))))
            in_millimetres = in_millimetres or looks_like_millimetres(sets)
        if warning := normals.warning(f"{TURN_ROUND}."):
            show(f"warning: {warning}")
        if in_millimetres:
            show(f"warning: {MILLIMETRES}.")
        count, bad = 0, set()
        # A second time through the file, so that warnings come first and faults need not be kept.
        for first, raw in numbered_chunks(source, CHUNK):
            for fault in adjustments.apply(raw).faults(first):
                show(fault)
                count += 1
                bad.add(fault.index[0])
        total = len(source)
    if count:
        announce(f"{count:,} fault(s) in {len(bad):,} of {total:,} grasps")
        return 1
    show(f"{total:,} grasps, no fault" + (f"; {normals.away:,} with doubtful normals" if normals.away else ""))
    return 0


def _facts(sets: ContactSets) -> dict:
    def span(values: np.ndarray) -> tuple[float, float]:
        return float(np.min(values, initial=np.inf)), float(np.max(values, initial=-np.inf))

    optional = {name: getattr(sets, name) for name in ("torsion", "normal_min", "normal_max", "torque_max")}
    return {name: span(array) for name, array in optional.items() if array is not None} | {
        "sizes": sets.sizes,
        "joints": 0 if sets.torque_max is None else sets.torque_max.shape[-1],
        "radius": span(sets.reach()),
        "friction": span(sets.friction),
        "squeeze": span(sets.squeeze),
        "force": span(np.linalg.norm(sets.wrench[..., :3], axis=-1)),
        "torque": span(np.linalg.norm(sets.wrench[..., 3:], axis=-1)),
        "labels": {name: np.unique(values.astype(str)) for name, values in sets.labels.items()},
        "millimetres": looks_like_millimetres(sets),
    }


def rank_command(arguments: Rank) -> int:
    """Show the first grasps as a table."""
    rows = ranked_rows(arguments.results, arguments.by, arguments.top, arguments.smallest)
    cells = [[name, *map(_cell, values.tolist())] for name, values in rows.items()]
    widths = [max(map(len, column)) for column in cells]
    for line in zip(*cells, strict=True):
        show("  ".join(text.ljust(width) for text, width in zip(line, widths, strict=True)).rstrip())
    return 0


def _cell(value: object) -> str:
    return f"{value:.6g}" if isinstance(value, float) else printable(str(value))


def show_command(arguments: Show) -> int:
    """Find the grasp, answer, and draw."""
    # Imported for this command alone: the others start without meshes, pages and a solver.
    from jaxgrasp.cli.machine import set_up_jax
    from jaxgrasp.hand.mesh import load_mesh
    from jaxgrasp.report.shown_grasp import show as draw

    adjustments = adjustments_of(arguments)
    mesh = None if arguments.mesh is None else load_mesh(arguments.mesh, arguments.scale)
    sets, number = _chosen(arguments, adjustments)
    for fault in sets.faults():
        raise GraspError(fault)
    if not 0 <= arguments.wrench < sets.wrenches:
        raise ValueError(f"wrench is {arguments.wrench}: expected 0 to {sets.wrenches - 1}")
    set_up_jax("float64")
    limits = sets.limits(sets.largest)
    single = jax.tree.map(lambda leaf: leaf[0], limits)
    name = str(sets.labels["name"][0]) if "name" in sets.labels else f"grasp {number}"
    wrench = sets.wrench[0, arguments.wrench]
    draw(
        arguments.out, sets.grasp(0), wrench, limits=single, method=arguments.method, solid=mesh, title=name or "grasp"
    )
    show(f"{arguments.out}: {name}")
    return 0


def _chosen(arguments: Show, adjustments: Adjustments) -> tuple[ContactSets, int]:
    """Return the grasp of the wanted name, or else of that number, as a set of one, and its number in the file."""
    query = GraspQuery(arguments.grasp)
    with opened(arguments, adjustments) as source:
        for raw in source.chunks(CHUNK):
            query.look(raw.labels.get("name"), len(raw))
        number = query.number(str(data_path(arguments.file)))
        return adjustments.apply(next(source.chunks(1, number))), number
