"""Output of the commands that make files of contacts: the file, and the lines about it on screen."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from jaxgrasp.batch.contact_sets import ContactSets
from jaxgrasp.batch.sources import save_grasps
from jaxgrasp.cli.terminal import show


def write_contacts(
    out: Path,
    contacts: ContactSets,
    labels: Mapping[str, np.ndarray],
    left_out: Mapping[str, np.ndarray],
    dropped: int = 0,
    hint: str = "",
) -> int:
    """Write the grasps that can be used, and say what was found; returns the exit code.

    Args:
        out: the file.
        contacts: all grasps.
        labels: of each grasp.
        left_out: which grasps cannot be used, for each reason.
        dropped: contacts beyond the deepest of each grasp.
        hint: what may be wrong where no grasp can be used.
    """
    usable = ~np.any(list(left_out.values()), axis=0)
    words = _left_out_words(left_out)
    if not usable.any():
        raise ValueError(f"none of the {len(contacts)} grasps can be used: {'; '.join(words)}{hint}")
    sets = replace(contacts, labels=labels).rows(np.flatnonzero(usable))
    out.parent.mkdir(parents=True, exist_ok=True)
    save_grasps(out, sets)
    sizes = Counter(sets.sizes.tolist())
    shares = ", ".join(f"{count} with {size}" for size, count in sorted(sizes.items()))
    show("\n".join([f"{len(sets)} grasps by their number of contacts: {shares}", *words]))
    if dropped:
        show(f"dropped: {dropped} contacts beyond the deepest of each grasp")
    show(f"written: {out}")
    return 0


def _left_out_words(left_out: Mapping[str, np.ndarray]) -> list[str]:
    """Format a line for each reason: the number of grasps left out, and the indices of the first five."""
    return [
        f"left out: {chosen.sum()} {reason} (the first: {', '.join(map(str, np.flatnonzero(chosen)[:5]))})"
        for reason, chosen in left_out.items()
        if chosen.any()
    ]
