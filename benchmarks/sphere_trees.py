"""Sphere trees of meshes: what their balls leave out of the solid, and where a descent beats trying all balls.

    python -m benchmarks.sphere_trees --out benchmarks/results

A human hand in a power grip on a cylinder, and the same cylinder as a mesh in trees of more and more levels. Writes
sphere_trees.json and sphere_trees.md.
"""

from benchmarks.one_thread import one_thread

one_thread()

import argparse
import json
import time
from pathlib import Path

import jax
import numpy as np
import trimesh

import jaxgrasp
from benchmarks.machine import machine
from benchmarks.page import tree_tables
from benchmarks.page.clock import interleaved
from jaxgrasp.grip.power_grip import power_grip
from jaxgrasp.hand import Cylinder, Mesh, Pose, Posture, SphereTree
from jaxgrasp.hand.filling import cell_size, filling_error

NAME = "sphere_trees"
RADIUS, HEIGHT, SECTIONS = 0.03, 0.12, 256
DEPTH, POSES, SHIFT = 2e-3, 64, 5e-4
"""Depth of the grip [m]; poses, and how far the object is moved from one to the next (standard deviation) [m]."""
SHALLOW = 4e-3
"""Depth up to which contacts are judged [m]."""


def measure(levels: int, mesh: Mesh, repeats: int) -> dict:
    """Measure one tree: its size, the volume that it leaves out, and times and contacts by both searches."""
    start = time.perf_counter()
    tree = jaxgrasp.hand.sphere_tree(mesh, levels, descends=False)
    seconds = time.perf_counter() - start
    error = filling_error(tree, mesh)
    hand, posture, placed = scene()
    find = jaxgrasp.hand.find_contacts
    exact = find(hand, posture, Cylinder(RADIUS, HEIGHT), placed)
    ways = {"all": tree, "descent": SphereTree(tree.balls, tree.nodes, tree.moments, True)}
    calls = {
        name: lambda t=t: jax.block_until_ready(jaxgrasp.hand.find_contacts(hand, posture, t, placed))
        for name, t in ways.items()
    }
    spent = interleaved(calls, repeats, 10.0)
    contacts_by_way = {name: call() for name, call in calls.items()}
    return {
        "levels": levels,
        "cell": cell_size(mesh, levels),
        "balls": error.balls,
        "left_out_largest": error.largest,
        "left_out_mean": error.mean,
        "build_seconds": seconds,
        "microseconds": {name: seconds_spent / POSES * 1e6 for name, seconds_spent in spent.items()},
        "tests": {name: float(contacts.tests.mean()) for name, contacts in contacts_by_way.items()},
        "ways_differ": max(
            float(abs(getattr(contacts_by_way["all"], name) - getattr(contacts_by_way["descent"], name)).max())
            for name in ("points", "normals", "depths")
        ),
        **against(exact, contacts_by_way["descent"]),
    }


def against(exact: jaxgrasp.hand.Contacts, contacts: jaxgrasp.hand.Contacts) -> dict:
    """Compare contacts with those of the exact shape where both touch, and count where only one does."""
    shallow = np.asarray((exact.depths > 0) & (exact.depths < SHALLOW))
    both_touch = shallow & np.asarray(contacts.present > 0)
    angles = np.degrees(np.arccos(np.clip(np.sum(contacts.normals * exact.normals, -1), -1, 1)))[both_touch]
    depths = np.abs(np.asarray(contacts.depths - exact.depths))[both_touch]
    return {
        "judged": int(shallow.sum()),
        "missed_share": float(1 - both_touch.sum() / shallow.sum()),
        "depth_error_median": float(np.median(depths)),
        "normal_error_degrees_median": float(np.median(angles)),
        "normal_error_degrees_largest": float(angles.max()),
    }


def scene() -> tuple[jaxgrasp.hand.Hand, Posture, Pose]:
    hand = jaxgrasp.hand.human_hand()
    posture, placed, _ = power_grip(hand, Cylinder(RADIUS, HEIGHT), DEPTH)
    shifts = np.random.default_rng(0).normal(scale=SHIFT, size=(POSES, 3))
    return hand, posture, Pose(placed.origin + shifts, placed.rotation)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results"), help="folder of the two files")
    parser.add_argument("--levels", type=int, nargs="+", default=[2, 3, 4, 5, 6], help="of the trees")
    parser.add_argument("--repeats", type=int, default=7, help="turns of each way")
    options = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    options.out.mkdir(parents=True, exist_ok=True)
    solid = trimesh.creation.cylinder(RADIUS, HEIGHT, sections=SECTIONS)
    mesh = Mesh(np.array(solid.vertices), np.array(solid.faces))
    rows = [measure(levels, mesh, options.repeats) for levels in options.levels]
    setting = {"radius": RADIUS, "height": HEIGHT, "depth": DEPTH, "poses": POSES, "shift": SHIFT, "shallow": SHALLOW}
    report = {"machine": machine(), "setting": setting, "rows": rows}
    (options.out / f"{NAME}.json").write_text(json.dumps(report, indent=1) + "\n")
    (options.out / f"{NAME}.md").write_text(tree_tables.page(report))


if __name__ == "__main__":
    main()
