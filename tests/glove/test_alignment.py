"""A tracker that is strapped on as it comes moves the hand as the hand moves."""

import json

import numpy as np
import pytest

from jaxgrasp.cli import glove_setup
from jaxgrasp.cli.glove_run import Wrist
from jaxgrasp.cli.main import main
from jaxgrasp.glove.other_devices.alignment import (
    aligned,
    at_home,
    load_alignment,
    rotation_of,
    save_alignment,
    with_lever,
)
from jaxgrasp.glove.other_devices.polhemus import Tracker, TrackerSample


def quaternion(rng: np.random.Generator) -> np.ndarray:
    turn = rng.normal(size=4)
    return turn / np.linalg.norm(turn)


def about(axis: int, degrees: float) -> np.ndarray:
    half = np.radians(degrees) / 2
    return np.append(np.cos(half), np.sin(half) * np.eye(3)[axis])


def composed(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the quaternion of one rotation after another, by the definition of the product."""
    return np.append(a[0] * b[0] - a[1:] @ b[1:], a[0] * b[1:] + b[0] * a[1:] + np.cross(a[1:], b[1:]))


def inverse(a: np.ndarray) -> np.ndarray:
    return a * (1, -1, -1, -1)


class Rig:
    """A transmitter somewhere in the room and a receiver somewhere on the wrist, which see a hand's true poses."""

    def __init__(self, seed: int, lever: tuple[float, ...] = (0.0, 0.0, 0.0)) -> None:
        rng = np.random.default_rng(seed)
        self.transmitter, self.receiver = quaternion(rng), quaternion(rng)
        self.place = rng.normal(size=3)
        self.lever = np.array(lever)

    def sees(self, origin: np.ndarray, turn: np.ndarray) -> TrackerSample:
        """Return the sample of a wrist at an origin, turned by a quaternion."""
        worn_at = origin + rotation_of(turn) @ self.lever
        position = rotation_of(self.transmitter).T @ (worn_at - self.place)
        rotation = composed(composed(inverse(self.transmitter), turn), self.receiver)
        return TrackerSample(1, position, rotation, " ")


HOME = np.array([1.0, 0, 0, 0])


class Quiet(Tracker):
    """Tracker that is never read."""

    def __init__(self, line, protocol) -> None:
        pass

    def close(self) -> None:
        pass


def shown(rig: Rig, height: float = 0.12) -> list[TrackerSample]:
    places = ([0, 0, 0], [0.15, 0, 0], [0, 0, height])
    return [rig.sees(np.array(place, float), HOME) for place in places]


@pytest.mark.parametrize("seed", range(5))
def test_three_places_tell_every_pose(seed):
    rig, rng = Rig(seed), np.random.default_rng(100 + seed)
    alignment = aligned(*shown(rig))
    for _ in range(20):
        origin, turn = rng.normal(size=3), quaternion(rng)
        place, rotation = alignment.pose(rig.sees(origin, turn))
        np.testing.assert_allclose(place, origin, atol=1e-12)
        np.testing.assert_allclose(rotation, rotation_of(turn), atol=1e-12)


def turns(n: int, reach: float = 70.0) -> list[np.ndarray]:
    """Return turns of a hand that rolls and bends its wrist by up to ``reach`` degrees."""
    phases = np.linspace(0, 2 * np.pi, n, endpoint=False)
    return [composed(about(0, reach * np.sin(t)), about(1, 0.6 * reach * np.cos(3 * t))) for t in phases]


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("lever", [(0.0, 0.0, 0.0), (0.07, 0.0, 0.03), (-0.05, 0.02, 0.04)])
def test_a_hand_that_turns_in_place_tells_the_receivers_lever_arm(seed, lever):
    rig, rng = Rig(seed, lever), np.random.default_rng(100 + seed)
    pivot = 0.2 * rng.normal(size=3)
    alignment = aligned(*shown(rig), [rig.sees(pivot, turn) for turn in turns(40)])
    np.testing.assert_allclose(alignment.lever, lever, atol=1e-12)
    for _ in range(20):
        origin, turn = rng.normal(size=3), quaternion(rng)
        place, rotation = alignment.pose(rig.sees(origin, turn))
        np.testing.assert_allclose(place, origin, atol=1e-12)
        np.testing.assert_allclose(rotation, rotation_of(turn), atol=1e-12)


def test_a_wrist_that_moves_a_little_and_a_noisy_tracker_leave_the_lever_arm_within_millimetres():
    rig, rng = Rig(3, (0.07, 0.0, 0.03)), np.random.default_rng(0)
    samples = [rig.sees(rng.normal(scale=2e-3, size=3), turn) for turn in turns(300)]
    lever = with_lever(aligned(*shown(rig)), samples).lever
    np.testing.assert_allclose(lever, rig.lever, atol=2e-3)


@pytest.mark.parametrize(
    ("samples", "words"),
    [
        (lambda rig: [rig.sees(np.zeros(3), HOME)] * 2, "turned has 2 samples: expected 3 or more"),
        (lambda rig: [rig.sees(np.zeros(3), HOME)] * 9, "turns of 0 degrees .* about the second axis"),
        (
            lambda rig: [rig.sees(np.zeros(3), about(0, k)) for k in range(-80, 80)],
            "about the second axis: expected 15",
        ),
        (lambda rig: [rig.sees(np.zeros(3), turn) for turn in turns(40, 10.0)], "about the second axis"),
        (
            lambda rig: [rig.sees(np.array([0.03 * (-1) ** k, 0, 0]), turn) for k, turn in enumerate(turns(40))],
            "the wrist moved by 30 mm .*: expected at most 10 mm",
        ),
    ],
)
def test_turns_that_tell_no_lever_arm_are_refused(samples, words):
    rig = Rig(2, (0.07, 0.0, 0.03))
    with pytest.raises(ValueError, match=words):
        aligned(*shown(rig), samples(rig))
    with pytest.raises(ValueError, match="the receiver seems to be 50 cm from the wrist's centre"):
        far = Rig(2, (0.5, 0.0, 0.0))
        aligned(*shown(far), [far.sees(np.zeros(3), turn) for turn in turns(40)])


def test_a_file_without_a_lever_arm_has_none(folder):
    save_alignment(aligned(*shown(Rig(1))), folder / "a.json")
    contents = json.loads((folder / "a.json").read_text())
    del contents["lever"]
    (folder / "a.json").write_text(json.dumps(contents))
    np.testing.assert_array_equal(load_alignment(folder / "a.json").lever, 0)


def test_moves_that_are_not_quite_square_leave_up_as_it_was_shown():
    rig = Rig(7)
    home, _, up = shown(rig)
    forward = rig.sees(np.array([0.15, 0.0, 0.03]), HOME)
    alignment = aligned(home, forward, up)
    np.testing.assert_allclose(alignment.pose(up)[0], [0, 0, 0.12], atol=1e-12)
    place, _ = alignment.pose(forward)
    assert place[1] == pytest.approx(0, abs=1e-12) and place[0] == pytest.approx(0.15)


@pytest.mark.parametrize("first", [about(0, 80), about(1, -120), quaternion(np.random.default_rng(3))])
def test_the_first_sample_is_the_hand_at_home_however_it_is_turned(first):
    """A first sample rolled by 80 degrees does not roll the hand; what it turns from there does."""

    class Fake(Tracker):
        def __init__(self) -> None:
            self.sampled_at = 0.0
            self.sample = TrackerSample(1, np.array([0.3, -0.2, 0.5]), first, " ")

        def poll(self, timestamp: float) -> TrackerSample:
            return self.sample

    tracker = Fake()
    wrist = Wrist(tracker)
    start = wrist(0.0)
    np.testing.assert_allclose(start.origin, 0, atol=1e-12)
    np.testing.assert_allclose(start.rotation, np.eye(3), atol=1e-12)
    tracker.sample = TrackerSample(1, np.array([0.4, -0.2, 0.5]), composed(about(2, 30), first), " ")
    moved = wrist(0.0)
    np.testing.assert_allclose(moved.origin, [0.1, 0, 0], atol=1e-12)
    np.testing.assert_allclose(moved.rotation, rotation_of(about(2, 30)), atol=1e-12)


@pytest.mark.parametrize(
    ("places", "words"),
    [
        (([0, 0, 0], [0.01, 0, 0], [0, 0, 0.1]), "forward is 1.0 cm from home: expected 5 cm or more"),
        (([0, 0, 0], [0.1, 0, 0], [0, 0, 0.02]), "up is 2.0 cm from home"),
        (([0, 0, 0], [0.1, 0, 0], [0.1, 0, 0.05]), "up is 27 degrees from forward: expected about 90"),
    ],
)
def test_moves_that_tell_no_direction_are_refused(places, words):
    with pytest.raises(ValueError, match=words):
        aligned(*(TrackerSample(1, np.array(place, float), HOME, " ") for place in places))


def test_it_is_kept_in_a_file(folder):
    rig = Rig(1, (0.07, 0.0, 0.03))
    alignment = aligned(*shown(rig), [rig.sees(np.zeros(3), turn) for turn in turns(40)])
    save_alignment(alignment, folder / "a.json")
    read = load_alignment(folder / "a.json")
    for name in ("transmitter", "receiver", "zero", "lever"):
        np.testing.assert_array_equal(getattr(read, name), getattr(alignment, name))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"alignment": 2}, "expected the entry 'alignment' to be 1"),
        ({"zero": [1, 2]}, r"zero is \[1, 2\]: expected numbers of shape \(3,\)"),
        ({"zero": [1, 2, "x"]}, "zero is"),
        ({"lever": [1, 2]}, r"lever is \[1, 2\]: expected numbers of shape \(3,\)"),
        ({"receiver": np.diag([1, 1, -1]).tolist()}, "receiver is not a rotation"),
        ({"transmitter": None}, r"transmitter is None: expected numbers of shape \(3, 3\)"),
    ],
)
def test_a_file_that_is_none_is_refused(folder, change, words):
    save_alignment(at_home(shown(Rig(1))[0]), folder / "a.json")
    good = json.loads((folder / "a.json").read_text())
    (folder / "a.json").write_text(json.dumps(good | change))
    with pytest.raises(ValueError, match=words):
        load_alignment(folder / "a.json")


def test_the_command_asks_until_the_hand_is_still_and_until_it_has_turned(folder, monkeypatch, capsys):
    rig, prompts = Rig(4, (0.07, 0.0, 0.03)), []
    home, forward, up = shown(rig)
    shaken = [home, rig.sees(np.array([0.02, 0, 0]), HOME)]
    heard = iter([shaken, [home] * 3, [forward], [up]])
    monkeypatch.setattr(glove_setup, "SerialLine", lambda port, baud: port)
    monkeypatch.setattr(glove_setup, "Tracker", Quiet)
    monkeypatch.setattr(glove_setup, "_listen", lambda tracker: next(heard))
    turning = iter([[rig.sees(np.zeros(3), turn) for turn in turns(40, reach)] for reach in (5.0, 70.0)])
    monkeypatch.setattr(glove_setup, "_listen_turning", lambda tracker: next(turning))
    monkeypatch.setattr(glove_setup, "typed", lambda prompt: prompts.append(prompt) or "")
    assert main(["glove", "align", "somewhere", "--out", "a.json"]) == 0
    output = capsys.readouterr().out
    assert len(prompts) == 6 and "the hand moved by 20 mm meanwhile" in output
    assert "about the second axis" in output and "the receiver is at (70, 0, 30) mm" in output
    place, _ = load_alignment(folder / "a.json").pose(rig.sees(np.array([0.1, 0.2, 0.3]), about(0, 90)))
    np.testing.assert_allclose(place, [0.1, 0.2, 0.3], atol=1e-12)
    heard = iter([[home] * 3, [forward], [up]])
    assert main(["glove", "align", "somewhere", "--no-turn", "--out", "b.json"]) == 0
    assert len(prompts) == 9 and "counts as at the wrist's centre" in capsys.readouterr().out
    np.testing.assert_array_equal(load_alignment(folder / "b.json").lever, 0)


def test_a_port_that_does_not_exist_is_said(folder, capsys):
    assert main(["glove", "align", "/dev/nowhere", "--out", "a.json"]) == 1
    assert "nowhere" in capsys.readouterr().err and not (folder / "a.json").exists()
