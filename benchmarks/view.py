"""The live scene: how long from a posture to a picture, how a file of grasps is stepped through, and pictures of it.

    python -m benchmarks.view --out benchmarks/results

Writes view.json and view.md, and with the section ``pictures`` three pictures. Chromium draws without a graphics card,
which takes most of the time to the picture; where there is none, or no playwright, that time and the pictures are left
out.
"""

import gc
import os
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks.browser import CHROMIUM, chromium
from benchmarks.machine import processor_seconds
from benchmarks.page import view_tables
from benchmarks.sections import run_sections
from jaxgrasp.numerics.compiled_code import use_cache

NAME = "view"
MARGIN = 120
"""What is left out on the left of a picture [pixels]."""
PICTURES = Path("benchmarks/results")


class Plan(NamedTuple):
    frames: int = 100
    grasps: int = 1000
    seconds: float = 20.0
    """For how long a loop ticks beside a page."""


QUICK = Plan(frames=5, grasps=20, seconds=2.0)
LOOP, BENT = 100.0, 0.15
"""Ticks a second, and by how much farther the joints are bent than the grip [rad], so that 14 links or more touch."""


def live_hand() -> Any:
    """Return a hand of 19 links around the ready cylinder, clear of its table."""
    import jax

    from jaxgrasp.grip.scene_entries import TableEntry
    from jaxgrasp.grip.scene_file import SceneFile, gripped_scene
    from jaxgrasp.view.live_scene import LiveHand

    jax.config.update("jax_enable_x64", True)
    use_cache()
    return LiveHand(gripped_scene(SceneFile(table=TableEntry(below=0.4))), "optimum")


def frames(plan: Plan) -> dict:
    """Measure the milliseconds from a posture to its picture, to the sent data, and to the browser's drawing."""
    from jaxgrasp.view.live_page import LivePage
    from jaxgrasp.view.viewer_server import serving

    hand = live_hand()
    start_s = time.perf_counter()
    first = hand.initial_controls()
    solved = hand.look(first)
    compiling = time.perf_counter() - start_s
    ways: dict[str, list[tuple[float, float]]] = {"seen": [], "sent": []}
    with serving(port=0) as server:
        page = LivePage(server, hand)
        page.frame()
        for k in range(plan.frames):
            share = float(np.sin(0.1 * k))
            with timed(ways["seen"]):
                hand.look(first._replace(angles=first.angles * (1 + 1e-3 * share)))
            page.set(bend=0.1 * share)
            with timed(ways["sent"]):
                page.frame()
        html = page.html()
        if CHROMIUM:
            ways["drawn"] = [(milliseconds, np.nan) for milliseconds in in_browser(page, server, plan)]
    return {
        "links": len(hand.gripped.scene.hand.links),
        "contacts": int(solved.touching.sum()),
        "compiling_s": compiling,
        "load": os.getloadavg()[0],
        "milliseconds": {name: spread(np.array(pairs)) for name, pairs in ways.items()},
        "saved_megabytes": len(html) / 1e6,
    }


@contextmanager
def timed(times: list[tuple[float, float]]) -> Iterator[None]:
    """Append the milliseconds that the block takes, by the clock and of the processors."""
    start_s = time.perf_counter(), time.process_time()
    yield
    times.append((1e3 * (time.perf_counter() - start_s[0]), 1e3 * (time.process_time() - start_s[1])))


def spread(times: np.ndarray) -> dict:
    """Return the median and 99th percentile by the clock, and the median of the processors' time where it is known."""
    clock, processors = times.T
    statistics = {"median": float(np.median(clock)), "p99": float(np.quantile(clock, 0.99))}
    return statistics | ({} if np.isnan(processors).any() else {"processors": float(np.median(processors))})


# Done when the words have changed and the frame after them is drawn.
WATCH = """() => { window.drawn = new Promise(done => new MutationObserver((_, watch) => {
    watch.disconnect(); requestAnimationFrame(() => requestAnimationFrame(() => done(Date.now())));
}).observe(document.querySelector('[data-hold]').parentElement.parentElement,
    {subtree: true, childList: true, characterData: true})) }"""


def in_browser(page: Any, server: Any, plan: Plan) -> Iterator[float]:
    """Yield the milliseconds from a posture that is set to the frame that shows it, by the clock that both have."""
    with tempfile.TemporaryDirectory() as folder, chromium(Path(folder)) as browser:
        browser.open(f"http://127.0.0.1:{server.get_port()}")
        browser.page.wait_for_selector("[data-hold]", timeout=60_000)
        browser.page.wait_for_timeout(3000)
        for k in range(max(3, plan.frames // 10)):
            browser.page.evaluate(WATCH)
            start_s = time.time()
            page.set(bend=-0.2 - 0.05 * k)
            page.frame()
            yield browser.page.evaluate("() => window.drawn") - 1e3 * start_s


def steps(plan: Plan) -> dict:
    """Step through the grasps of a file, and measure times and memory before and after."""
    from jaxgrasp.view.grasp_page import GraspPage, GraspSteps
    from jaxgrasp.view.viewer_server import serving

    sets = shipped(plan.grasps)
    with serving(port=0) as server:
        page = GraspPage(server, GraspSteps(sets, "optimum"))
        held, messages, spent = [], [], []
        for _ in range(3):
            for rank in range(1, len(sets) + 1):
                page.rank.value = rank
                page.frame()
                spent.append(page.seconds)
            gc.collect()
            held.append(memory())
            messages.append(len(server._websock_server._broadcast_buffer.message_from_id))
    return {
        "grasps": len(sets),
        "milliseconds": float(1e3 * np.median(spent)),
        "megabytes": [size / 1e6 for size in held],
        "messages": messages,
    }


def beside(plan: Plan) -> dict:
    """Measure the frames a second that reach a browser beside a haptic loop, and the loop's delays with and without.

    The browser is a client that reads everything and draws nothing: Chromium without a graphics card would take both
    processors for itself.
    """
    from jaxgrasp.glove.loop.exchange import GloveState
    from jaxgrasp.glove.loop.rendering import TickTimes
    from jaxgrasp.glove.model import lrp_hand_master
    from jaxgrasp.lab.haptic_loop import Haptics, pose_at
    from jaxgrasp.view.view_slots import Carried, ViewFeed, ViewFrame

    gripped, model = live_hand().gripped, lrp_hand_master()
    closed = np.asarray(gripped.closed.angles)
    haptics = Haptics(gripped.scene, model, closed, gripped.placed, "optimum")
    channels, wrist = list(haptics.glove.joint_indices), pose_at(np.zeros(3))
    haptics.warm_up(wrist)
    period, none, contacts = 1 / LOOP, np.zeros(len(channels)), []

    def loop(feed: ViewFeed | None) -> dict:
        times, spent = TickTimes(period), []
        start_s = due = time.perf_counter()
        while (tick_s := time.perf_counter()) < start_s + plan.seconds:
            angles = closed[channels] + BENT * (1 + 0.02 * np.sin(8 * tick_s))
            law = haptics.tick(tick_s, angles, wrist)
            if feed is not None:
                state = GloveState(tick_s, 3, 2, tick_s, tick_s, angles, none, none)
                feed.write(ViewFrame.ticked(state, law, Carried.at(wrist, haptics.followed).vector()))
            over = time.perf_counter()
            contacts.append(int(np.sum(haptics.instant.tick.contacts.present)) if haptics.instant else 0)
            times.add(tick_s - due, over - tick_s)
            spent.append((1e3 * (over - tick_s), np.nan))
            due = max(due + period, over)
            time.sleep(max(0.0, due - time.perf_counter()))
        return {"ticks": times.summary()["turns"] / plan.seconds, "milliseconds": spread(np.array(spent))}

    alone = loop(None)
    extra_size = Carried.size(1, len(gripped.scene.hand.links))
    shown = {"made": gripped, "law": "optimum", "worn": haptics.glove}
    with ViewFeed(len(channels), extra_size, shown, (0,)) as feed, reading(feed.addresses[0]) as frames:
        loop(feed)
        frames.clear()
        before = processor_seconds(feed.process_id)
        followed = loop(feed)
        arrived, spent = len(frames), processor_seconds(feed.process_id) - before
    return {
        "links": len(gripped.scene.hand.links),
        "contacts": int(np.median(contacts)),
        "load": os.getloadavg()[0],
        "niceness": os.nice(0),
        "frames": arrived / plan.seconds,
        "frame_ms": 1e3 * spent / max(arrived, 1),
        "alone": alone,
        "followed": followed,
    }


@contextmanager
def reading(address: str) -> Iterator[list[float]]:
    """Yield the times at which frames of a page reach a client that reads all and draws nothing."""
    import viser
    import zstandard
    from websockets.exceptions import ConnectionClosed
    from websockets.sync.client import connect

    frames: list[float] = []
    version = [f"viser-v{viser.__version__}"]
    with connect(address.replace("http", "ws"), subprotocols=version, max_size=None, compression=None) as line:

        def read() -> None:
            with suppress(ConnectionClosed):
                for message in line:
                    # Two lengths, then what is said, compressed; numbers come after it.
                    size = int.from_bytes(message[8:16], "little")
                    text = zstandard.ZstdDecompressor().decompressobj().decompress(message[16 : 16 + size])
                    if b"data-latency" in text:
                        frames.append(time.perf_counter())

        reader = threading.Thread(target=read)
        reader.start()
        try:
            yield frames
        finally:
            line.close()
            reader.join()


def pictures(plan: Plan) -> list[str]:
    """Take pictures of a live hand, a hand that the object escapes, and the worst shipped grasps in the real viewer."""
    from jaxgrasp.view.grasp_page import GraspPage, GraspSteps
    from jaxgrasp.view.live_page import LivePage

    hand = live_hand()
    with looped(lambda server: LivePage(server, hand)) as (page, address):
        shoot(address, "view_live")
        page.set(friction=0.0)
        shoot(address, "view_escape")
    with looped(lambda server: GraspPage(server, GraspSteps(shipped(plan.grasps), "optimum"))) as (page, address):
        page.order.value = "worst first"
        page.change()
        shoot(address, "view_grasps")
    return ["view_live.png", "view_escape.png", "view_grasps.png"]


def shoot(address: str, name: str) -> None:
    """Save a picture of a page, without the empty margin on its left."""
    from PIL import Image

    with tempfile.TemporaryDirectory() as folder, chromium(Path(folder)) as browser:
        browser.open(address)
        browser.page.wait_for_selector("[data-hold]", timeout=60_000)
        browser.page.wait_for_timeout(6000)
        browser.close_notes()
        path = Path(folder) / "picture.png"
        browser.page.screenshot(path=path, clip={"x": MARGIN, "y": 0, "width": 1280 - MARGIN, "height": 820})
        Image.open(path).convert("RGB").save(PICTURES / f"{name}.png", optimize=True)


@contextmanager
def looped(make: Any) -> Iterator[tuple[Any, str]]:
    """Run a page in a loop of its own; yield the page and its address."""
    from jaxgrasp.view.viewer_server import serving

    over = threading.Event()
    with serving(port=0) as server:
        page = make(server)
        page.frame()
        loop = threading.Thread(target=page.run, args=(lambda: not over.is_set(),))
        loop.start()
        try:
            yield page, f"http://127.0.0.1:{server.get_port()}"
        finally:
            over.set()
            loop.join()


def shipped(count: int) -> Any:
    """Return the first of the grips that ship with the package."""
    import jax

    from jaxgrasp.batch.sources import load_grasps
    from jaxgrasp.cli.arguments import Data
    from jaxgrasp.cli.grasp_files import data_path

    jax.config.update("jax_enable_x64", True)
    use_cache()
    return load_grasps(data_path(Data())).rows(slice(0, count))


def memory() -> int:
    """Return the memory of this process (Linux) [bytes]."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGESIZE")


SECTIONS = {"frames": frames, "steps": steps, "beside": beside, "pictures": pictures}


if __name__ == "__main__":
    run_sections(__doc__, NAME, SECTIONS, (Plan(), QUICK), view_tables.page)
