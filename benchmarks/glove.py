"""The glove's promises, put to the test: bad lines, hosts that die, long runs, and what a tick takes.

    python -m benchmarks.glove --out benchmarks/results

Writes glove.json and glove.md; each section can be made again alone (``--sections``). Torques are those that the
simulated device holds, by its own clock, behind a pseudo-terminal that is as slow as the line it stands for. The long
run takes half an hour and wants a quiet machine; the rest takes some minutes.
"""

import ctypes
import itertools
import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks.page import glove_tables
from benchmarks.sections import run_sections
from jaxgrasp.glove.glove_device import LinkState
from jaxgrasp.glove.guard import Guard, GuardState
from jaxgrasp.glove.loop.child import WorkerProcess
from jaxgrasp.glove.loop.exchange import GloveState, TorqueLaw
from jaxgrasp.glove.loop.glove_process import GloveProcess
from jaxgrasp.glove.loop.peers import EngineLink
from jaxgrasp.glove.model import lucidgloves
from jaxgrasp.glove.network.link import NetworkLink
from jaxgrasp.glove.network.messages import Exchange
from jaxgrasp.glove.other_devices.lucidgloves import LucidHost
from jaxgrasp.glove.other_devices.polhemus import FastrakAscii, FastrakBinary, IsotrakBinary
from jaxgrasp.glove.protocol.frames import CHANNELS, LINE_SIZE, Flag, Frame, FrameReader, Kind, Sequence, encode
from jaxgrasp.glove.simulated.simulation import FaultInjector, MemoryLine
from jaxgrasp.glove.simulated.simulator import Simulator, read_record
from jaxgrasp.grip.monitor import Law

NAME = "glove"
SPRING = 0.25
AFTER = 0.3
"""How long a fault is watched [s]."""


class Plan(NamedTuple):
    frames: int = 1_000_000
    spoilt: float = 0.2
    random_bytes: int = 1_000_000
    trials: int = 20
    minutes: float = 30.0
    ticks: int = 2000
    tower_steps: int = 300


QUICK = Plan(frames=20_000, random_bytes=20_000, trials=1, minutes=0.2, ticks=20, tower_steps=5)


def frames(plan: Plan) -> dict:
    """Send frames over a bad line: none wrong accepted, none lost beside the faults, and the numbers add up."""
    rng, injector = random.Random(1), FaultInjector(plan.spoilt, 2)
    reader, order = FrameReader(), Sequence(2**16 - 1)
    sent: dict[int, Frame] = {}
    wrong, accepted, last = 0, 0, -1
    line = bytearray()
    start_s = time.perf_counter()
    for k in range(plan.frames):
        values = tuple(rng.randrange(-(2**15), 2**15) for _ in range(CHANNELS))
        frame = Frame(Kind.COMMAND, k % 2**16, 5000 * k % 2**32, values, Flag.ENABLE)
        sent[frame.sequence] = frame
        line += injector.inject(encode(frame))
        if len(line) > 4096 or k == plan.frames - 1:
            for decoded in reader.feed(bytes(line)):
                if order.is_new(decoded.sequence):
                    accepted += 1
                    wrong += sent.get(decoded.sequence) != decoded
                    last = decoded.sequence
            line.clear()
    after = (plan.frames - 1 - last) % 2**16
    return {
        "sent": plan.frames,
        "faults": injector.faults,
        "wrong": wrong,
        "accepted": accepted,
        "missing": order.missing + after,
        "stale": order.stale,
        "refused": {reason.name: count for reason, count in reader.refused.items()},
        "adds_up": accepted + order.missing + after == plan.frames,
        "lost_of_good": plan.frames - accepted - injector.faults,
        "seconds": time.perf_counter() - start_s,
    }


def rubbish(plan: Plan) -> list[dict]:
    """Feed random bytes to every decoder: none raises, none keeps more than 512 of them."""
    exchange = Exchange(1, 50)
    readers: dict[str, tuple[Callable[[bytes], Any], Callable[[], int]]] = {}
    native = FrameReader()
    readers["native frames"] = native.feed, lambda: len(native._buffer)
    for kind in (IsotrakBinary, FastrakAscii, FastrakBinary):
        decoder = kind()
        readers[kind.__name__] = decoder.feed, lambda decoder=decoder: len(decoder.buffer)
    line = MemoryLine(115_200)
    lucid = LucidHost(lucidgloves(), lambda: line, Guard(lucidgloves()))

    def lucid_feed(data: bytes) -> None:
        line.to_host += data
        lucid.poll(0.0)

    readers["LucidGloves"] = lucid_feed, lambda: len(lucid._buffer)
    readers["link messages"] = lambda data: exchange.incoming(0.0, data), lambda: 0
    rows = []
    for name, (feed, buffered) in readers.items():
        rng, most_buffered, n_bytes = random.Random(3), 0, 0
        while n_bytes < plan.random_bytes:
            piece = rng.randbytes(rng.randrange(1, 2000))
            n_bytes += len(piece)
            feed(piece)
            most_buffered = max(most_buffered, buffered())
        rows.append({"decoder": name, "bytes": n_bytes, "most_kept": most_buffered})
    return rows


class Engine:
    """A spring, computed a hundred times a second in a thread."""

    def __init__(self, state: Callable[[], GloveState | None], write: Callable[[TorqueLaw], None]) -> None:
        self.state, self.write = state, write
        self.is_over = False
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        while not self.is_over:
            state = self.state()
            if state is not None and np.all(np.isfinite(state.angles)):
                angles = state.angles
                torques = np.maximum(SPRING * (angles - 0.2), 0)
                self.write(TorqueLaw(time.perf_counter(), True, angles, torques, SPRING * np.diag(angles > 0.2)))
            time.sleep(0.01)

    def stop(self) -> None:
        self.is_over = True
        self._thread.join()


def armed(state: Callable[[], GloveState | None], arm: Callable[[], None]) -> None:
    """Arm and wait for torque; a machine that is busy may need another try."""
    for _ in range(50):
        end = time.perf_counter() + 3
        while time.perf_counter() < end:
            glove_state = state()
            if glove_state is not None and glove_state.link == LinkState.LINKED:
                break
            time.sleep(0.01)
        time.sleep(0.1)
        try:
            arm()
        except (ValueError, OSError):
            continue
        while time.perf_counter() < end + 2:
            glove_state = state()
            if glove_state is not None and glove_state.guard == GuardState.ARMED and np.min(glove_state.torques) > 0.02:
                return
            time.sleep(0.01)
    raise RuntimeError("the glove never held torque")


def zero_times(plan: Plan) -> list[dict]:
    """Measure the time for which the device still holds torque after each failure [ms]."""
    ways = {
        "I/O process stopped (SIGSTOP)": lambda s, g: g.child.process.send_signal(signal.SIGSTOP),
        "I/O process killed (SIGKILL)": lambda s, g: g.child.process.kill(),
        "I/O process ended (SIGTERM)": lambda s, g: g.child.process.terminate(),
        "port closed (cable unplugged)": lambda s, g: s.order(unplug=AFTER),
        "line cut, port still open": lambda s, g: s.order(cut=AFTER),
        "engine's interpreter stalled (a C call holds the lock)": lambda s, g: stall(AFTER),
    }
    rows = [one_way(name, fail, plan) for name, fail in ways.items()]
    return [*rows, network_cut(plan)]


def drifting_faults(plan: Plan) -> list[dict]:
    """Measure, with drifting delays, for how long an independent device holds torque after a fault [ms]."""
    from tests.glove.independent_rig import FAULTS, WAYS, one_fault

    rng = random.Random(4)
    return [
        {
            "fault": name,
            "milliseconds": [
                1e3
                * one_fault(name, device_kind, rng.randrange(2**30), rng.uniform(-0.005, 0.005), rng.uniform(0.2, 1.2))
                for _ in range(max(plan.trials // 4, 1))
                for device_kind in WAYS
            ],
        }
        for name in FAULTS
    ]


def stall(seconds: float) -> None:
    """Hold the interpreter's lock, as a long call of a library in C would."""
    ctypes.PyDLL(None).usleep(ctypes.c_uint(int(1e6 * seconds)))


def one_way(name: str, fail: Callable[[Simulator, GloveProcess], Any], plan: Plan) -> dict:
    spent = []
    for _ in range(plan.trials):
        with tempfile.TemporaryDirectory() as folder, Simulator(**recorded(folder)) as simulator:
            simulator.order(bend=[0.6] * CHANNELS, lasts=0.2)
            with GloveProcess(simulator.port, CHANNELS, scale=1.0, ramp=0.2) as glove:
                engine = Engine(glove.state, glove.write)
                armed(glove.state, glove.arm)
                since = time.perf_counter()
                fail(simulator, glove)
                time.sleep(max(0.0, since + AFTER - time.perf_counter()))
                spent.append(held_after(folder, since))
                engine.stop()
                glove.child.process.kill()
    return {"way": name, "milliseconds": spent}


def network_cut(plan: Plan) -> dict:
    """Measure two hosts, of which the engine's falls silent: its link is cut."""
    spent = []
    for _ in range(plan.trials):
        with tempfile.TemporaryDirectory() as folder, Simulator(**recorded(folder)) as simulator:
            simulator.order(bend=[0.6] * CHANNELS, lasts=0.2)
            options = {"port": simulator.port, "listen": ["127.0.0.1", 0], "scale": 1.0, "ramp": 0.2}
            host = WorkerProcess("jaxgrasp.glove.loop.io_process", options)
            port = host.wait_for(lambda message: "listens" in message)["listens"]
            far = EngineLink(NetworkLink("127.0.0.1", port, GloveState.size(CHANNELS)), CHANNELS)
            heard: dict[str, GloveState | None] = {}
            engine = Engine(partial(listen, far, heard), partial(speak, far))
            armed(partial(heard.get, "state"), partial(host.order, {"arm": True}))
            since = time.perf_counter()
            far.close()
            time.sleep(AFTER)
            spent.append(held_after(folder, since))
            engine.stop()
            host.process.kill()
            host.close()
    return {"way": "network link cut", "milliseconds": spent}


def listen(far: EngineLink, heard: dict[str, GloveState | None]) -> GloveState | None:
    """Read the glove's state from the engine's link into ``heard`` and return it."""
    heard["state"] = far.state(time.perf_counter())
    return heard["state"]


def speak(far: EngineLink, law: TorqueLaw) -> None:
    far.write(time.perf_counter(), law)


def recorded(folder: str) -> dict[str, Any]:
    return {"record": str(Path(folder) / "record"), "record_every": 0.001}


def held_after(folder: str, since: float) -> float:
    record = read_record(Path(folder) / "record")
    held = record["time"][record["counts"].any(axis=1)]
    return 1e3 * max(0.0, float(held[-1]) - since)


def relinks(plan: Plan) -> dict:
    """Measure the times from a port's return to a new link [ms], and whether the glove stayed latched meanwhile."""
    spent, latched = [], True
    with Simulator() as simulator, GloveProcess(simulator.port, CHANNELS, scale=1.0, ramp=0.2) as glove:
        simulator.order(bend=[0.6] * CHANNELS, lasts=0.2)
        engine = Engine(glove.state, glove.write)
        for _ in range(plan.trials):
            armed(glove.state, glove.arm)
            before = len(glove.events())
            simulator.order(unplug=0.5)
            restored_at = time.perf_counter() + 0.5
            time.sleep(2.5)
            linked = [event for event in glove.events()[before:] if event["link"] == "LINKED"]
            spent.append(1e3 * (linked[-1]["at"] - restored_at) if linked else float("inf"))
            glove_state = glove.state()
            latched &= (
                glove_state is not None and glove_state.guard == GuardState.LATCHED and not glove_state.torques.any()
            )
        engine.stop()
    return {"milliseconds": spent, "latched": bool(latched)}


def long_run(plan: Plan) -> dict:
    """Run the glove two hundred times a second for long: memory, frames, punctuality."""
    with Simulator() as simulator, GloveProcess(simulator.port, CHANNELS, scale=1.0, ramp=0.2) as glove:
        engine = Engine(glove.state, glove.write)
        simulator.order(bend=[0.6] * CHANNELS, lasts=0.2)
        armed(glove.state, glove.arm)
        time.sleep(2.0)
        begin = {
            name: memory(process_id) for name, process_id in (("host", glove.child.process.pid), ("this", os.getpid()))
        }
        start_s, arming = time.perf_counter(), 1
        end = start_s + 60 * plan.minutes
        goes_there, loads = False, []
        while time.perf_counter() < end:
            loads.append(os.getloadavg()[0])
            simulator.order(bend=[0.6 if goes_there else 0.3] * CHANNELS, lasts=1.0)
            goes_there = not goes_there
            time.sleep(1.0)
            glove_state = glove.state()
            if glove_state is not None and glove_state.guard != GuardState.ARMED:
                arming += 1
                armed(glove.state, glove.arm)
        grown = {"host": memory(glove.child.process.pid) - begin["host"], "this": memory(os.getpid()) - begin["this"]}
        glove.disarm()
        engine.stop()
        time.sleep(0.1)
        before = glove.child.count
        glove.child.order({"report": True})
        report = glove.child.wait_for(lambda message: "report" in message, before)["report"]
        device = simulator.order(report=1)
    refused = sum(device["refused"].values())
    return {
        "minutes": plan.minutes,
        "grown_megabytes": {name: size / 2**20 for name, size in grown.items()},
        "armings": arming,
        "load": [min(loads), max(loads)],
        "processors": os.cpu_count(),
        "summary": glove.summary,
        "device": {name: device[name] for name in ("accepted", "missing", "stale")} | {"refused": refused},
        "device_frames": {"heard": report["heard"], "missing": report["missing"]},
        "most_in_flight": device["waiting"],
    }


def memory(process: int) -> int:
    """Return the memory of a process (Linux) [bytes]."""
    pages = int(Path(f"/proc/{process}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGESIZE")


SCENES = ("cylinder", "stack")
"""Scenes with one object and with three."""
TOWERS = (2, 4, 8)
"""Numbers of blocks on one another."""


def ticks(plan: Plan) -> dict:
    """Measure the ticks of the haptic loop while the fingers move and the hand lifts, with and without the kernel, each
    in a process of its own."""
    rows = []
    for scene, law, kernel in itertools.product(SCENES, ("closed-form", "optimum"), ("1", "0")):
        code = f"import json, benchmarks.glove as g; print(json.dumps(g.scene_ticks({scene!r}, {law!r}, {plan.ticks})))"
        command, environment = [sys.executable, "-c", code], {**os.environ, "JAXGRASP_KERNEL": kernel}
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
        rows.append(json.loads(done.stdout.splitlines()[-1]))
    return {"line": 1e3 * 10 * LINE_SIZE / 115_200, "rows": rows}


def scene_ticks(name: str, law: Law, count: int) -> dict:
    """Run ticks, 10 ms apart; return milliseconds of the processor without the first of them, and its seconds."""
    import jax

    from jaxgrasp.glove.model import lrp_hand_master
    from jaxgrasp.grip.scene_file import load_scene, scene_path
    from jaxgrasp.kernel import is_used
    from jaxgrasp.lab.haptic_loop import Haptics, pose_at
    from jaxgrasp.lab.loaded_scene import loaded_scene
    from jaxgrasp.lab.world_haptics import WorldHaptics
    from jaxgrasp.world.quasi_static import QuasiStaticEngine
    from jaxgrasp.world.world_file import world_of

    jax.config.update("jax_enable_x64", True)
    file, model = load_scene(scene_path(name)), lrp_hand_master()
    gripped = loaded_scene(file)
    closed = np.asarray(gripped.closed.angles)
    if file.other:
        world, state = world_of(file, gripped)
        haptics = WorldHaptics(world, model, closed, state, QuasiStaticEngine(world, state), law)
    else:
        haptics = Haptics(gripped.scene, model, closed, gripped.placed, law)
    flexions = closed[list(model.joint_indices(gripped.scene.hand.joints))]
    spent, contacts = [], 0
    for k in range(count + 1):
        wrist = pose_at(np.array([0.0, 0.0, 0.05 * min(k / 100, 1.0)]))
        start_s = time.process_time()
        haptics.tick(0.01 * k, flexions * (1 + 0.02 * np.sin(0.08 * k)), wrist)
        spent.append(time.process_time() - start_s)
        contacts = max(contacts, int(np.any(haptics.contact_forces()[0], axis=-1).sum()))
    milliseconds = 1e3 * np.array(spent[1:])
    return {
        "scene": name,
        "objects": 1 + len(file.other),
        "law": law,
        "kernel": is_used(),
        "contacts": contacts,
        "first": spent[0],
        "median": float(np.median(milliseconds)),
        "p99": float(np.quantile(milliseconds, 0.99)),
    }


def towers(plan: Plan) -> list[dict]:
    """Measure the steps of both engines of several objects, of 10 ms, for towers of blocks at rest: milliseconds of the
    processor, and the first step's seconds."""
    import jax

    from jaxgrasp.grip import Body, Scene
    from jaxgrasp.hand import Box, Pose, Posture, parallel_jaw, pose_hand
    from jaxgrasp.world import HandMove, MujocoEngine, QuasiStaticEngine, RigidBody, World, at_rest
    from jaxgrasp.world.hand_share import find_touches

    jax.config.update("jax_enable_x64", True)
    hand, block, mass, rubbing = parallel_jaw(), Box(0.06, 0.05, 0.04), 0.2, 0.5
    away = Posture(Pose(np.array([0.0, 0.0, 5.0]), np.eye(3)), np.zeros(len(hand.joints)))
    frames = jax.device_get(pose_hand(hand, away))
    rows = []
    for count, engine_type in itertools.product(TOWERS, (QuasiStaticEngine, MujocoEngine)):
        ground, gravity = Pose(np.zeros(3), np.eye(3)), np.array([0.0, 0.0, -9.81])
        scene = Scene(
            hand, Body(block, mass), ground, 0.8, 2000.0, np.ones(len(hand.links)), gravity, table_friction=rubbing
        )
        world = World(scene, (RigidBody(Body(block, mass), 0.8, 2000.0, rubbing),) * (count - 1))
        heights = block.height * (np.arange(count) + 0.5)
        placed = Pose(heights[:, None] * np.array([0.0, 0.0, 1.0]), np.stack([np.eye(3)] * count))
        state = at_rest(placed)
        contacts = jax.device_get(find_touches(world, away, state.placed).contacts)
        engine, spent = engine_type(world, state), []
        for _ in range(plan.tower_steps + 1):
            start_s = time.process_time()
            state = engine.step(state, HandMove(contacts, frames, frames), 0.01).state
            spent.append(time.process_time() - start_s)
        rows.append(
            {
                "engine": engine_type.__name__,
                "blocks": count,
                "first": spent[0],
                "median": 1e3 * float(np.median(spent[1:])),
                "moved": float(np.abs(state.placed.origin - placed.origin).max()),
            }
        )
    return rows


SECTIONS: dict[str, Callable[[Plan], Any]] = {
    "frames": frames,
    "rubbish": rubbish,
    "zero_times": zero_times,
    "drifting_faults": drifting_faults,
    "relinks": relinks,
    "ticks": ticks,
    "towers": towers,
    "long_run": long_run,
}


if __name__ == "__main__":
    run_sections(__doc__, NAME, SECTIONS, (Plan(), QUICK), glove_tables.page)
