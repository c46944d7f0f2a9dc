"""Write the file of simulated grips: ``python -m benchmarks.contact_sets.make --out FILE.npz --seed 0``.

Grips are simulated one after the other until ``--count`` of them are kept; what happened to the rest is
counted in a JSON file beside it. Every sample depends on (seed, sample) only: ``close.simulate`` makes one
again.

Squeezing forces are eq. 6 with c = 1 and one stiffness for the whole file, chosen so that the median, over
sets, of total squeeze over the engine's total normal force is 1. The engine's own normal forces would flatter
method B, which shares by squeeze, and are only kept beside.

Frame of every set: origin at the object's centre of mass, axes of the hand's world, in which gravity's
direction is random. What ``jaxgrasp`` reads is in double precision; what is only kept beside, in single.
"""

from __future__ import annotations

import argparse
import importlib.metadata
import json
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from benchmarks.contact_sets.close import Grip, simulate
from jaxgrasp.interop.mujoco_contacts import MujocoGrasp

FORMAT_VERSION = 1
PACKAGES = {"myohand": "myo-sim", "shadow": "gymnasium-robotics"}


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--out", type=Path, required=True, help="file.npz; the report goes to file.json")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--count", type=int, default=3360, help="grips to keep")
    options = parser.parse_args(arguments)
    attempts = list(until(options.count, options.seed))
    grips = [grip for grip in attempts if grip.contacts is not None]
    np.savez_compressed(options.out, **columns(grips, options.seed))
    text = json.dumps(report(attempts, options.seed), indent=1)
    options.out.with_suffix(".json").write_text(text + "\n", encoding="utf-8")


def until(count: int, seed: int) -> Iterator[Grip]:
    """Yield every grip from sample 0 on, until ``count`` are kept."""
    n_grips = sample = 0
    while n_grips < count:
        grip = simulate(seed, sample)
        n_grips += grip.contacts is not None
        sample += 1
        yield grip


def columns(grips: list[Grip], seed: int) -> dict[str, np.ndarray]:
    """Return the arrays of the file by name; contacts of set i are rows ``offsets[i]`` to ``offsets[i + 1]``."""
    sets = [grip.contacts for grip in grips if grip.contacts is not None]
    stiffness = common_stiffness(sets)
    depth = np.concatenate([contacts.depths for contacts in sets])
    of_contacts = {
        "points": np.concatenate([contacts.grasp.points for contacts in sets]),
        "normals": np.concatenate([contacts.grasp.normals for contacts in sets]),
        "friction": np.concatenate([contacts.grasp.friction for contacts in sets]),
        "squeeze": stiffness * depth,
        "depth": depth.astype(np.float32),
        "normal_force": np.concatenate([contacts.grasp.squeeze for contacts in sets]).astype(np.float32),
        "simulated_force": np.concatenate([contacts.forces for contacts in sets]).astype(np.float32),
    }
    of_sets = {
        "wrench": np.stack([contacts.wrench for contacts in sets]),
        "mass": np.array([g.held_object.mass for g in grips]),
    }
    versions = {hand: f"{package} {importlib.metadata.version(package)}" for hand, package in PACKAGES.items()}
    return {
        "version": np.array(FORMAT_VERSION),
        "seed": np.array(seed),
        "stiffness": np.array(stiffness),
        **of_contacts,
        **of_sets,
        "offsets": np.cumsum([0, *(len(contacts.links) for contacts in sets)], dtype=np.int64),
        "link": np.array([link for contacts in sets for link in contacts.links]),
        "name": np.array([f"{grip.hand}-{grip.grip}-{grip.shape}-{grip.sample:05d}" for grip in grips]),
        "source": np.array([f"MuJoCo {importlib.metadata.version('mujoco')}, {versions[g.hand]}" for g in grips]),
        "object": np.array([grip.shape for grip in grips]),
        "hand": np.array([grip.hand for grip in grips]),
        "grip": np.array([grip.grip for grip in grips]),
        "sample": np.array([grip.sample for grip in grips], np.int32),
    }


def common_stiffness(sets: list[MujocoGrasp]) -> float:
    """Return the K [N/m] with which the median of total squeeze over total normal force is 1, in whole N/m."""
    given_way = [contacts.depths.sum() / contacts.grasp.squeeze.sum() for contacts in sets]
    return float(np.round(1 / np.median(given_way)))


def report(attempts: list[Grip], seed: int) -> dict[str, object]:
    """Count the attempted grips by outcome, and the kept ones by type."""
    tree: dict[str, Counter[str]] = {}
    contacts: Counter[int] = Counter()
    for grip in attempts:
        tree.setdefault(f"{grip.hand}, {grip.shape}, placed for {grip.recipe}", Counter())[grip.outcome] += 1
        if grip.contacts is not None:
            contacts[len(grip.contacts.links)] += 1
    kept_grips = [grip for grip in attempts if grip.contacts is not None]
    return {
        "seed": seed,
        "attempted": len(attempts),
        "outcomes": _sorted(Counter(grip.outcome for grip in attempts)),
        "kept": _sorted(Counter(f"{grip.hand}, {grip.shape}, {grip.grip}" for grip in kept_grips)),
        "outcomes by hand, object and placement": {key: _sorted(tree[key]) for key in sorted(tree)},
        "sets by number of contacts": {str(n): contacts[n] for n in sorted(contacts)},
        "versions": {package: importlib.metadata.version(package) for package in ("mujoco", *PACKAGES.values())},
    }


def _sorted(counts: Counter[str]) -> dict[str, int]:
    return {key: counts[key] for key in sorted(counts)}


if __name__ == "__main__":
    main()
