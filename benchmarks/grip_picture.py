"""README's picture: one of the shipped grips whose closed form slips, with its optimum.

python -m benchmarks.grip_picture --out benchmarks/results/grip.png
"""

import argparse
from pathlib import Path

import jax
import matplotlib
import numpy as np

import jaxgrasp
from jaxgrasp.cli.grasp_files import data_path

matplotlib.use("Agg")
import matplotlib.pyplot as plt

METHODS = {"B": ("closed form (method B)", "#d55e00"), "B-optimum": ("constrained optimum", "#0072b2")}
MILLIMETRE = 1e3


def choose(evaluation: jaxgrasp.Evaluation) -> int:
    """Return a grip of four to six contacts whose closed form is far from its optimum: the fifth by friction gap."""
    closed, best = (evaluation.results[name] for name in METHODS)
    sizes = evaluation.sets.sizes
    fit = (best.verdict[:, 0] == jaxgrasp.Verdict.OPTIMAL) & (sizes >= 4) & (sizes <= 6)
    price = np.where(fit, 1 - closed.objective[:, 0] / np.where(fit, best.objective[:, 0], 1), -1)
    return int(np.argsort(-price)[4])


def draw_cone(axes, apex: np.ndarray, normal: np.ndarray, friction: float, length: float) -> None:
    across = np.linalg.svd(normal[None])[2][1:]
    turn, along = np.meshgrid(np.linspace(0, 2 * np.pi, 40), [0, length])
    around = np.cos(turn)[..., None] * across[0] + np.sin(turn)[..., None] * across[1]
    surface = apex + along[..., None] * (normal + friction * around)
    axes.plot_surface(*np.moveaxis(surface, -1, 0), color="0.6", alpha=0.18, linewidth=0)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, required=True)
    arguments = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    sets = jaxgrasp.load_grasps(data_path(None))
    evaluation = jaxgrasp.evaluate(sets, methods=tuple(METHODS))
    index = choose(evaluation)
    rows = slice(sets.offsets[index], sets.offsets[index + 1])
    points = MILLIMETRE * sets.points[rows]
    reach = np.ptp(points, axis=0).max()
    largest = np.linalg.norm(evaluation.results["B-optimum"].forces[rows, 0], axis=1).max()
    per_newton = 0.5 * reach / largest

    tips = [points + per_newton * evaluation.results[name].forces[rows, 0] for name in METHODS]
    corners = np.concatenate([points, *tips])
    limits = corners.min(0) - 0.08 * reach, corners.max(0) + 0.08 * reach

    figure = plt.figure(figsize=(10, 4.6), dpi=150)
    for number, (name, (title, colour)) in enumerate(METHODS.items(), 1):
        axes = figure.add_subplot(1, 2, number, projection="3d", proj_type="ortho")
        result = evaluation.results[name]
        forces = per_newton * result.forces[rows, 0]
        for contact, (point, normal) in enumerate(zip(points, sets.normals[rows], strict=True)):
            draw_cone(axes, point, normal, sets.friction[rows][contact], 0.2 * reach)
        axes.quiver(*points.T, *forces.T, color=colour, linewidth=2.2, arrow_length_ratio=0.15)
        axes.scatter(*points.T, color="black", s=14, depthshade=False)
        margin = np.degrees(result.margin[index, 0])
        says = f"slips or pulls: worst margin {margin:.0f}°" if margin < -1e-6 else "every force inside its cone"
        axes.set_title(f"{title}\n{says}", fontsize=10)
        axes.set(xlabel="x [mm]", ylabel="y [mm]", zlabel="z [mm]")
        axes.tick_params(labelsize=6)
        low, high = limits
        axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
        axes.set_box_aspect(high - low, zoom=1.05)
        axes.view_init(elev=18, azim=-55)
    scale = f"largest force {largest:.2g} N"
    figure.suptitle(f"{sets.labels['name'][index]}: {rows.stop - rows.start} contacts, {scale}", fontsize=9, y=0.03)
    figure.savefig(arguments.out)


if __name__ == "__main__":
    main()
