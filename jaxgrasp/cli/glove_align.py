"""``jaxgrasp glove align``: three places of the hand to how its tracker stands."""

import time
from collections.abc import Callable

import numpy as np

from jaxgrasp.cli.glove_arguments import Align
from jaxgrasp.cli.terminal import show, typed
from jaxgrasp.glove.line import SerialLine
from jaxgrasp.glove.other_devices.alignment import aligned, save_alignment
from jaxgrasp.glove.other_devices.polhemus import TrackerSample
from jaxgrasp.glove.other_devices.tracker import Tracker

PLACES = {
    "home": "hold the hand at home, palm down and fingers forward, where the object will be before it",
    "forward": "move it forward by 10 cm or more, not turning it",
    "up": "bring it back home, then move it up by 10 cm or more",
}
LISTENED, STEADY = 0.5, 0.005
"""Time of sampling at a place [s], and largest distance between samples of one place [m]."""


def align_command(arguments: Align) -> int:
    """Ask for the three places, and write what they say."""
    tracker = Tracker(SerialLine(arguments.tracker, arguments.tracker_baud), arguments.tracker_protocol)
    try:
        samples = {name: _sample_at(tracker, instruction, typed) for name, instruction in PLACES.items()}
    finally:
        tracker.close()
    save_alignment(aligned(samples["home"], samples["forward"], samples["up"]), arguments.out)
    show(f"written: {arguments.out}; jaxgrasp glove run --alignment {arguments.out} uses it")
    return 0


def _sample_at(tracker: Tracker, instruction: str, ask: Callable[[str], str]) -> TrackerSample:
    """Ask the person to go to a place, and return a sample once the hand holds still there."""
    while True:
        ask(f"{instruction}; Enter when it is there ")
        samples = _listen(tracker)
        if not samples:
            raise OSError(
                f"the tracker sent nothing for {LISTENED} s: check that it is on, and that its protocol is right"
            )
        positions = np.stack([sample.position for sample in samples])
        apart = float(np.linalg.norm(positions - positions[0], axis=1).max())
        if apart <= STEADY:
            return samples[len(samples) // 2]
        show(f"the hand moved by {1e3 * apart:.0f} mm meanwhile: expected at most {1e3 * STEADY:.0f}; try again")


def _listen(tracker: Tracker) -> list[TrackerSample]:
    """Collect the tracker's samples for ``LISTENED`` seconds, each once."""
    samples: list[TrackerSample] = []
    started = time.perf_counter()
    while (time_s := time.perf_counter()) < started + LISTENED:
        sample = tracker.poll(time_s)
        if sample is not None and tracker.sampled_at >= started and (not samples or sample is not samples[-1]):
            samples.append(sample)
        time.sleep(0.005)
    return samples
