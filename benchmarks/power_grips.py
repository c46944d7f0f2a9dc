"""Power grips by method B: how often the closed form stays inside the friction cones, and what helps.

    python -m benchmarks.power_grips --out benchmarks/results

Writes power_grips.json and power_grips.md. Every grip holds its object still while gravity points anywhere, so that
what differs is only how much of the squeezing forces is left unbalanced.
"""

import argparse
import json
from pathlib import Path

import jax
import numpy as np

jax.config.update("jax_enable_x64", True)

import jaxgrasp
from benchmarks.machine import machine
from jaxgrasp import Grasp, Verdict
from jaxgrasp.grip import GripType, balanced_contributions, contributions_of, grip_type, power_grip
from jaxgrasp.hand import Box, Capsule, Cylinder, Shape, Sphere, grasp_from_contacts, human_hand

POSES = 10_000
MASS, FRICTION, STIFFNESS, DEPTH = 0.4, 0.6, 1000.0, 2e-3
SHAPES: dict[str, Shape] = {
    "cylinder, 25 mm": Cylinder(0.025, 0.12),
    "cylinder, 30 mm": Cylinder(0.03, 0.12),
    "cylinder, 40 mm": Cylinder(0.04, 0.12),
    "capsule, 30 mm": Capsule(0.03, 0.12),
    "box, 50 mm": Box(0.05, 0.05, 0.12),
    "sphere, 35 mm": Sphere(0.035),
}


def measure(shape: Shape) -> dict:
    hand = human_hand()
    closed, placed, contacts = power_grip(hand, shape, DEPTH)
    table = np.asarray(contributions_of(hand, GripType(int(grip_type(hand, closed, contacts)))))
    thumb = np.array([link.finger == "thumb" for link in hand.links])
    fingers = ~thumb & np.array([link.joint >= 0 for link in hand.links])
    touching = np.asarray(contacts.present) > 0
    opposed = table.copy()
    # The thumb's links that touch share the sum of the fingers that they oppose.
    opposed[thumb & touching] = table[fingers & touching].sum() / max(1, (thumb & touching).sum())
    chosen = {
        "as the table has them": table,
        "thumb as the opposed fingers together": opposed,
        "balanced": np.asarray(balanced_contributions(contacts, table, placed.origin)),
    }
    down = np.random.default_rng(0).normal(size=(POSES, 3))
    down /= np.linalg.norm(down, axis=1, keepdims=True)
    wrench = np.concatenate([MASS * 9.81 * down, np.zeros((POSES, 3))], 1)
    rows = {}
    for name, contributions in chosen.items():
        world = grasp_from_contacts(contacts, FRICTION, STIFFNESS, contributions)
        grasp = Grasp(world.points - placed.origin, world.normals, world.friction, world.squeeze, world.present)
        pressed = np.asarray(grasp.squeeze) * touching
        closed_form, optimum = jaxgrasp.closed_form_and_optimum(grasp, wrench)
        rows[name] = {
            "squeezing_N": float(pressed.sum()),
            "unbalanced_N": float(np.linalg.norm(pressed @ np.asarray(grasp.normals))),
            "closed_form_inside": int((np.asarray(closed_form.verdict) == Verdict.CLOSED_FORM_OPTIMAL).sum()),
            "optimum_holds": int((np.asarray(optimum.verdict) <= Verdict.OPTIMAL).sum()),
        }
    return {"contacts": int(touching.sum()), "contributions": rows}


def page(grips: dict) -> str:
    lines = [
        "# Power grips by method B",
        "",
        f"`python -m benchmarks.power_grips --out benchmarks/results`. A hand of 0.19 m holds {1000 * MASS:g} g with "
        f"friction {FRICTION:g} in {POSES:,} directions of gravity. Table I gives the fingers' contributions of a "
        "cylindrical power grip and names neither thumb nor palm; of other grips all are 1. Where the squeezing forces "
        "leave much unbalanced, the closed form spreads what balances them over all contacts, and leaves the cones.",
        "",
        "| object | contacts | contributions | squeezing, N | unbalanced, N | closed form inside | optimum holds |",
        "|---|---|---|---|---|---|---|",
    ]
    for shape, grip in grips.items():
        for name, row in grip["contributions"].items():
            lines.append(
                f"| {shape} | {grip['contacts']} | {name} | {row['squeezing_N']:.1f} | {row['unbalanced_N']:.1f} "
                f"| {row['closed_form_inside'] / POSES:.1%} | {row['optimum_holds'] / POSES:.1%} |"
            )
    return "\n".join(lines) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, required=True)
    out = parser.parse_args().out
    grips = {name: measure(shape) for name, shape in SHAPES.items()}
    (out / "power_grips.json").write_text(json.dumps({"machine": machine(), "grips": grips}, indent=1) + "\n")
    (out / "power_grips.md").write_text(page(grips))


if __name__ == "__main__":
    main()
