"""``jaxgrasp info`` and ``jaxgrasp validate``: what a file holds, and what is wrong with it."""

import numpy as np

from jaxgrasp.batch.contact_sets import ContactSets
from jaxgrasp.batch.sources import (
    MILLIMETRES,
    TURN_ROUND,
    OutwardNormals,
    looks_like_millimetres,
    numbered_chunks,
    outward_normals,
)
from jaxgrasp.cli.data import adjustments_of, data_path, opened
from jaxgrasp.cli.data_arguments import Info, Validate
from jaxgrasp.cli.terminal import announce, show
from jaxgrasp.files.printable import printable

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
