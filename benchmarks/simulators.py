"""Thousands of simulated hands: from contacts to verdicts, beside the simulator's own step, in MuJoCo Warp.

    python -m benchmarks.simulators --out benchmarks/results

Writes simulators.json and simulators.md (extra ``warp``; Warp's device is the processor). A hand of three fingers, two
joints each, holds a ball on a table; in each world the ball and the fingers stand elsewhere. The calls take turns.
"""

import contextlib
import importlib
import io
import time
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import numpy as np

import jaxgrasp
from benchmarks.page import simulator_tables
from benchmarks.page.clock import interleaved
from benchmarks.sections import run_sections
from jaxgrasp.interop import from_mujoco_warp
from jaxgrasp.interop.mujoco_contacts import import_mujoco
from jaxgrasp.kernel.compiled import initialised_warp
from jaxgrasp.model.solution import is_held
from jaxgrasp.quality import hold_margin

NAME = "simulators"
FINGER = """
<body name="finger {number}" euler="0 0 {turn}">
  <body pos="0.06 0 0.11">
    <joint name="knuckle {number}" axis="0 1 0" range="-15 70" damping="0.02" armature="0.001"/>
    <geom type="capsule" fromto="0 0 0 0.015 0 -0.05" size="0.008" mass="0.03"/>
    <body pos="0.015 0 -0.05">
      <joint name="middle {number}" axis="0 1 0" range="-15 70" damping="0.02" armature="0.001"/>
      <geom type="capsule" fromto="0 0 0 -0.02 0 -0.035" size="0.008" mass="0.02"/>
      <geom name="tip {number}" type="sphere" pos="-0.025 0 -0.045" size="0.011" mass="0.01" friction="0.8" condim="4"/>
    </body>
  </body>
</body>
"""
SCENE = """
<mujoco>
  <option timestep="0.002" cone="elliptic" impratio="10" iterations="20" jacobian="dense"/>
  <worldbody>
    <geom name="table" type="plane" size="1 1 0.1" friction="0.5"/>
    <body name="palm">
      <geom type="cylinder" pos="0 0 0.14" size="0.07 0.01"/>
      {fingers}
    </body>
    <body name="ball" pos="0 0 0.0305">
      <freejoint/>
      <geom type="sphere" size="0.03" mass="0.1" friction="0.6" condim="4"/>
    </body>
  </worldbody>
  <actuator>{actuators}</actuator>
</mujoco>
"""
FINGERS = 3
SETTLING_S = 0.4
MAX_CONTACTS = 8
BUDGET_S = 30.0


class Plan(NamedTuple):
    worlds: int = 4096
    steps: int = 20
    """Of each world, before contacts are read."""
    repeats: int = 21


QUICK = Plan(64, 3, 3)


class Worlds(NamedTuple):
    model: Any
    """Of MuJoCo."""
    data: Any
    """Of MuJoCo Warp."""
    step: Callable[[], None]
    """Advance all worlds by a step, and wait."""


def simulated_worlds(plan: Plan) -> Worlds:
    """Return worlds in which the fingers have closed: in half of them on the ball, in the others beside its middle."""
    mujoco, warp = import_mujoco("benchmarks.simulators"), initialised_warp()
    mujoco_warp = _mujoco_warp()
    fingers = "".join(FINGER.format(number=k, turn=360 / FINGERS * k) for k in range(FINGERS))
    motor = '<position joint="{} {}" kp="4" ctrlrange="-1 2" forcerange="-0.3 0.3"/>'
    motors = "".join(motor.format(name, k) for k in range(FINGERS) for name in ("knuckle", "middle"))
    model = mujoco.MjModel.from_xml_string(SCENE.format(fingers=fingers, actuators=motors))
    state = mujoco.MjData(model)
    state.ctrl[:] = np.tile([0.6, 0.3], FINGERS)
    while state.time < SETTLING_S:
        mujoco.mj_step(model, state)
    rng = np.random.default_rng(0)
    qpos = np.tile(state.qpos, (plan.worlds, 1))
    joints = 2 * FINGERS
    qpos[:, :joints] += rng.normal(0, 0.01, (plan.worlds, joints))
    qpos[:, joints : joints + 2] += (
        rng.normal(0, 1, (plan.worlds, 2)) * np.where(np.arange(plan.worlds) % 2, 3e-2, 5e-4)[:, None]
    )
    with warp.ScopedDevice("cpu"):
        of_warp = mujoco_warp.put_model(model)
        data = mujoco_warp.make_data(model, nworld=plan.worlds, nconmax=16, njmax=64)
        for name, values in (("qpos", qpos), ("ctrl", np.tile(state.ctrl, (plan.worlds, 1)))):
            target = getattr(data, name)
            warp.copy(target, warp.array(values.astype(np.float32), dtype=target.dtype, device="cpu"))

    def step() -> None:
        with warp.ScopedDevice("cpu"):
            mujoco_warp.step(of_warp, data)
            warp.synchronize()

    # Warp lists the modules that it compiles.
    with contextlib.redirect_stdout(io.StringIO()):
        for _ in range(plan.steps):
            step()
    return Worlds(model, data, step)


def _mujoco_warp() -> Any:
    """Import MuJoCo Warp without what it prints."""
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        return importlib.import_module("mujoco_warp")


def times(plan: Plan) -> dict:
    """Measure the step and each stage from contacts to the margin: the first call, and the median of the others [s]."""
    worlds = simulated_worlds(plan)

    def read() -> Any:
        return from_mujoco_warp(worlds.model, worlds.data, "ball", hand="palm", max_contacts=MAX_CONTACTS)

    first = {}
    first["contacts"], contacts = _timed(read)
    grasp, wrench = contacts.grasp, contacts.wrench
    calls: dict[str, Callable[[], Any]] = {
        "step": worlds.step,
        "contacts": read,
        "closed form": lambda: jax.block_until_ready(jaxgrasp.closed_form(grasp, wrench)),
        "optimum": lambda: jax.block_until_ready(jaxgrasp.constrained_optimum(grasp, wrench)),
        "hold margin": lambda: jax.block_until_ready(hold_margin(grasp, wrench)),
    }
    first["closed form"], _ = _timed(calls["closed form"])
    first["optimum"], optimum = _timed(calls["optimum"])
    first["hold margin"], margin = _timed(calls["hold margin"])
    counts = np.asarray(grasp.present).sum(1)
    return {
        "first_s": first,
        "median_s": interleaved(calls, plan.repeats, BUDGET_S),
        "contacts": np.bincount(counts.astype(int), minlength=MAX_CONTACTS + 1).tolist(),
        "dropped": int(np.sum(contacts.dropped)),
        "held": int(np.sum(is_held(optimum.verdict))),
        "positive_margins": int(np.sum(np.asarray(margin) > 0)),
        "warp": initialised_warp().config.version,
    }


def _timed(call: Callable[[], Any]) -> tuple[float, Any]:
    start = time.perf_counter()
    result = call()
    return time.perf_counter() - start, result


def main() -> None:
    run_sections(__doc__, NAME, {"times": times}, (Plan(), QUICK), simulator_tables.page)


if __name__ == "__main__":
    main()
