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
        found = {name: _asked(tracker, what, typed) for name, what in PLACES.items()}
    finally:
        tracker.close()
    save_alignment(aligned(found["home"], found["forward"], found["up"]), arguments.out)
    show(f"written: {arguments.out}; jaxgrasp glove run --alignment {arguments.out} uses it")
    return 0


def _asked(tracker: Tracker, what: str, ask: Callable[[str], str]) -> TrackerSample:
    """Ask the person to go to a place, and return a sample once the hand holds still there."""
    while True:
        ask(f"{what}; Enter when it is there ")
        samples = _listen(tracker)
        if not samples:
            raise OSError(f"the tracker said nothing for {LISTENED} s: is it on, and its protocol the right one?")
        places = np.stack([sample.position for sample in samples])
        apart = float(np.linalg.norm(places - places[0], axis=1).max())
        if apart <= STEADY:
            return samples[len(samples) // 2]
        show(f"the hand moved by {1e3 * apart:.0f} mm meanwhile: expected at most {1e3 * STEADY:.0f}; once more")


def _listen(tracker: Tracker) -> list[TrackerSample]:
    """Collect the tracker's samples for ``LISTENED`` seconds, each once."""
    samples: list[TrackerSample] = []
    begun = time.perf_counter()
    while (now := time.perf_counter()) < begun + LISTENED:
        sample = tracker.poll(now)
        if sample is not None and tracker.sampled_at >= begun and (not samples or sample is not samples[-1]):
            samples.append(sample)
        time.sleep(0.005)
    return samples
