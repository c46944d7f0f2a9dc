"""Teleoperation: tasks by a simulated person with and without forces back, retargeting, energies of the network.

    python -m benchmarks.teleop --out benchmarks/results

Writes teleop.json, teleop.md, teleop.png and teleop.gif (`MUJOCO_GL=egl` without a screen); `--sections` makes
parts anew. About half an hour. The person is simulated: the success rates tell what this model makes of the forces, no
more.
"""

import time
from pathlib import Path
from typing import NamedTuple

import jax
import numpy as np
from scipy.optimize import Bounds, minimize

from benchmarks.network_runs import play
from benchmarks.page import teleop_tables
from benchmarks.sections import run_sections
from jaxgrasp.teleop import NetworkModel, Workplace, run_trial
from jaxgrasp.teleop.retarget import STEPS, tip_positions

NAME = "teleop"
RESULTS = Path("benchmarks/results")
DELAYS_MS = (0, 20, 50, 100, 200)
JITTER, LOSS = 0.02, 0.05
FELT = {"fingers and wrist": (True, True), "fingers": (True, False), "nothing": (False, False)}
"""Where the person feels forces, with ``has_feedback`` and ``has_wrist`` of a trial."""
FILMED_SEED, FRAMES_PER_SECOND = 0, 12


class Plan(NamedTuple):
    seeds: int = 100
    """Of the peg with each kind of forces and without, over a network without faults."""
    delayed_seeds: int = 5
    """Of each task, delay and kind of forces."""
    postures: int = 500
    networks: int = 10_000


QUICK = Plan(1, 1, 30, 40)


def _rows(task: str, seeds: int, delays_ms: tuple[int, ...], has_faults: bool) -> list[dict]:
    workplace, rows = Workplace(task), []
    for delay in delays_ms:
        network = NetworkModel(1e-3 * delay, JITTER, LOSS) if has_faults else NetworkModel()
        for felt, (has_feedback, has_wrist) in FELT.items():
            for seed in range(seeds):
                result = run_trial(workplace, seed, network=network, has_feedback=has_feedback, has_wrist=has_wrist)
                condition = {"task": task, "delay": delay, "felt": felt, "seed": seed}
                rows.append(condition | result._asdict())
    return rows


def peg(plan: Plan) -> list[dict]:
    return _rows("peg", plan.seeds, (0,), False)


def delayed_peg(plan: Plan) -> list[dict]:
    return _rows("peg", plan.delayed_seeds, DELAYS_MS, True)


def delayed_stack(plan: Plan) -> list[dict]:
    return _rows("stack", plan.delayed_seeds, DELAYS_MS, True)


def retargeting(plan: Plan) -> list[dict]:
    """Compare with the objective of dex-retargeting on a hand that closes, opens and closes again at 250 Hz."""
    workplace = Workplace("peg")
    program, person = workplace.retargeting, workplace.person
    calibration, robot, tips = program.calibration, program.robot, program._robot_tips
    rng = np.random.default_rng(0)
    times = np.arange(plan.postures) / 250
    closure = 0.3 + 0.25 * np.sin(2 * np.pi * 0.5 * times)
    joint_noise = 0.1 * np.sin(2 * np.pi * 0.3 * times[:, None] + rng.uniform(0, 6, len(person.joints)))
    shares = np.clip(closure[:, None] + joint_noise, 0, 0.9)
    postures = workplace.open + shares * (workplace.closed - workplace.open)
    rows = []
    for name, solve in (("damped least squares", program), ("dex-retargeting's objective", _HuberSolver(program))):
        program.reset()
        solve(postures[0])
        errors, jumps, seconds, last = [], [], [], None
        for posture in postures:
            # Of the processor: others ran on this machine at the same time.
            started = time.process_time()
            angles = solve(posture)
            seconds.append(time.process_time() - started)
            targets = np.asarray(calibration.targets(program.person_tips(posture)))
            errors.append(np.linalg.norm(np.asarray(tip_positions(robot, tips, angles)) - targets, axis=-1))
            jumps.append(0.0 if last is None else np.abs(angles - last).max())
            last = angles
        rows.append(
            {
                "method": name,
                "median_ms": 1e3 * float(np.median(seconds)),
                "ninety_ms": 1e3 * float(np.quantile(seconds, 0.9)),
                "error_mm": 1e3 * float(np.mean(errors)),
                "largest_error_mm": 1e3 * float(np.max(errors)),
                "largest_jump": float(np.max(jumps)),
            }
        )
    return [*rows, {"steps": STEPS}]


class _HuberSolver:
    """The position objective of dex-retargeting: Huber loss of the fingertips, and 4e-3 |q - q_last|^2, by SLSQP.

    Its loss has a width of 2 cm and its optimiser stops at a change of 1e-5, as there; its NLopt's SLSQP is SciPy's
    here, and the scales of the fingers are ours for both.
    """

    def __init__(self, program) -> None:
        self._program = program
        robot, tips = program.robot, program._robot_tips
        coupling = robot.coupling
        free = list(coupling.independent)
        self._free, self._coupling = free, coupling
        self._bounds = Bounds(np.asarray(robot.lower)[free], np.asarray(robot.upper)[free])

        def loss(independent, targets, last):
            angles = coupling.matrix @ independent + coupling.offset
            distance = jax.numpy.linalg.norm(tip_positions(robot, tips, angles) - targets, axis=-1)
            beta = 0.02
            huber = jax.numpy.where(distance < beta, 0.5 * distance**2 / beta, distance - 0.5 * beta)
            return huber.mean() + 4e-3 * jax.numpy.sum((independent - last) ** 2)

        self._loss = jax.jit(jax.value_and_grad(loss))
        self._last = np.asarray(program.open)[free]

    def __call__(self, posture):
        targets = np.asarray(self._program.calibration.targets(self._program.person_tips(posture)))
        last = self._last

        def value_and_gradient(x):
            value, gradient = self._loss(x, targets, last)
            return float(value), np.asarray(gradient, float)

        result = minimize(
            value_and_gradient, last, jac=True, method="SLSQP", bounds=self._bounds, options={"ftol": 1e-5}
        )
        self._last = result.x
        return np.asarray(self._coupling.matrix @ result.x + self._coupling.offset)


def passivity(plan: Plan) -> dict:
    """Find the least net energy of random networks, motions and walls, with and without the controllers."""
    controlled = min(play(seed, steps=250)[1] for seed in range(plan.networks))
    free = min(play(seed, steps=250, is_controlled=False)[1] for seed in range(plan.networks // 20))
    runs = {"runs": plan.networks, "free_runs": plan.networks // 20}
    return runs | {"controlled_mJ": 1e3 * controlled, "free_mJ": 1e3 * free}


def picture(plan: Plan) -> dict:
    """Draw the contact force and the glove's torque of one trial with each kind of forces and one without."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    workplace = Workplace("peg")
    figure, axes = plt.subplots(3, 1, figsize=(7, 6), sharex=True)
    for felt, (has_feedback, has_wrist) in FELT.items():
        rows = []

        def on_step(timestamp, follower, torques, rows=rows):
            force = np.linalg.norm(follower.environment_force())
            rows.append((timestamp, workplace.task.tip(follower)[2], force, np.sum(torques)))

        run_trial(workplace, FILMED_SEED, has_feedback=has_feedback, has_wrist=has_wrist, on_step=on_step)
        for axis, column in zip(axes, np.array(rows).T[1:], strict=True):
            axis.plot(np.array(rows)[:, 0], column, label=f"forces on {felt}")
    for axis, label in zip(axes, ("height of the tip [m]", "contact force [N]", "sum of torques [N.m]"), strict=True):
        axis.set_ylabel(label)
    axes[0].axhline(workplace.task.contact_height, color="grey", lw=0.5)
    axes[0].legend()
    axes[-1].set_xlabel("time [s]")
    figure.tight_layout()
    figure.savefig(RESULTS / "teleop.png", dpi=110)
    return {"seed": FILMED_SEED}


def film(plan: Plan) -> dict:
    """Film the first trial of the picture as a GIF of 12 pictures a second (needs MuJoCo's renderer)."""
    import mujoco
    from PIL import Image

    workplace, pictures = Workplace("peg"), []
    renderer = mujoco.Renderer(workplace.follower.model, 240, 320)
    camera = mujoco.MjvCamera()
    camera.lookat[:], camera.distance, camera.azimuth, camera.elevation = [0.0, 0.08, 0.08], 0.5, 150, -20

    def on_step(timestamp, follower, torques):
        if timestamp >= len(pictures) / FRAMES_PER_SECOND:
            renderer.update_scene(follower.data, camera)
            pictures.append(Image.fromarray(renderer.render()).quantize(64))

    run_trial(workplace, FILMED_SEED, has_wrist=True, on_step=on_step)
    first, *others = pictures
    lasts_ms = round(1000 / FRAMES_PER_SECOND)
    first.save(RESULTS / "teleop.gif", save_all=True, append_images=others, duration=lasts_ms, loop=0, optimize=True)
    return {"seed": FILMED_SEED, "pictures": len(pictures)}


SECTIONS = {
    "peg": peg,
    "delayed_peg": delayed_peg,
    "delayed_stack": delayed_stack,
    "retargeting": retargeting,
    "passivity": passivity,
    "picture": picture,
    "film": film,
}


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    run_sections(__doc__, NAME, SECTIONS, (Plan(), QUICK), teleop_tables.page)
