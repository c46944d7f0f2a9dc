"""A held probe: stiffness is recovered from what is felt, friction and texture are those of the surface."""

import numpy as np
import pytest

from jaxgrasp.glove.model import lrp_hand_master
from jaxgrasp.hand import human_hand
from jaxgrasp.hand.closing import closing_kinematics
from jaxgrasp.psychophysics import Counts, Model, Observer, PsychometricShape, threshold
from jaxgrasp.psychophysics.prediction import simulated_hits
from jaxgrasp.teleop.feedback import ForceFeedback
from jaxgrasp.teleop.probe import HeldProbe, Surface, load_heights

DOWN, UP = np.array([0, 0, -1.0]), np.array([0, 0, 1.0])
STILL = np.zeros(3)


@pytest.fixture(scope="module")
def probe():
    person, model = human_hand(), lrp_hand_master()
    closing = closing_kinematics(person)
    angles = np.asarray(closing.open) + 0.4 * (np.asarray(closing.closed) - np.asarray(closing.open))
    feedback = ForceFeedback(person, model, person, np.eye(3))
    return HeldProbe(feedback, angles, np.array([0.14, 0.02, -0.12]), squeeze=0.8)


def render(torques):
    """Return what the glove gives: within its limits, in its steps; and which channels no limit cuts."""
    model = lrp_hand_master()
    given = np.clip(np.floor(torques / model.quantum) * model.quantum, 0, model.limits)
    return given, (torques > 0) & (torques < np.array(model.limits))


@pytest.mark.parametrize("stiffness", [200.0, 500.0, 1500.0])
def test_stiffness_is_recovered_from_the_torques_within_a_tenth(probe, stiffness):
    surface = Surface(stiffness)
    depths = np.linspace(2e-4, 1.2 / stiffness, 12)
    felt = []
    for depth in depths:
        given, is_rendered = render(probe.torques(surface.force(np.array([0, 0, -depth]), STILL)))
        assert is_rendered.any()
        felt.append(probe.felt_force(given, UP, is_rendered))
    assert np.polyfit(depths, felt, 1)[0] == pytest.approx(stiffness, rel=0.1)


def test_a_tip_that_does_not_touch_feels_nothing(probe):
    surface = Surface(500.0, 0.4)
    assert not surface.force(np.array([0, 0, 0.01]), DOWN, radius=0.009).any()
    assert surface.force(np.array([0, 0, 0.01]), STILL, radius=0.012) == pytest.approx([0, 0, 1.0])


def test_friction_resists_sliding_by_coulombs_law_and_never_pushes_on():
    surface, tip = Surface(500.0, 0.4), np.array([0, 0, -0.002])
    for speed in (1e-4, 1e-3, 0.1):
        force = surface.force(tip, np.array([speed, 0, 0]))
        assert force[2] == pytest.approx(1.0)
        assert force[0] == pytest.approx(-0.4 * min(speed / 1e-3, 1))
    assert surface.force(tip, np.array([0, 0, -0.5]))[:2] == pytest.approx(0)


def test_texture_is_that_of_the_file(tmp_path):
    x = np.arange(20)
    heights = 1e-4 * np.sin(2 * np.pi * x / 20) * np.ones((4, 1))
    path = tmp_path / "ridges.csv"
    np.savetxt(path, heights, delimiter=",")
    surface = Surface(1000.0, heights=load_heights(path), spacing=5e-4)
    for place in (0.0011, 0.0025, 0.0123):
        force = surface.force(np.array([place, 0.0007, -1e-3]), STILL)
        height = 1e-4 * np.sin(2 * np.pi * place / 0.01)
        slope = 1e-4 * 2 * np.pi / 0.01 * np.cos(2 * np.pi * place / 0.01)
        assert force[0] / force[2] == pytest.approx(-slope, abs=2e-3)
        assert np.linalg.norm(force) == pytest.approx(1000 * (height + 1e-3) / np.hypot(1, slope), rel=2e-3)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("1,2\n3\n", "line 2 has 1 numbers: expected 2"),
        ("1,2\n3,x\n", "line 2, entry 2 is 'x'"),
        ("1,nan\n3,4\n", "line 1, entry 2"),
        ("1,2\n", "has 1 lines"),
    ],
)
def test_bad_height_files_are_refused_by_line(tmp_path, text, message):
    path = tmp_path / "heights.csv"
    path.write_text(text)
    with pytest.raises(ValueError, match=message):
        load_heights(path)


@pytest.mark.parametrize(
    ("field", "message"),
    [
        ({"stiffness": 0.0}, "stiffness is"),
        ({"friction": -1.0}, "friction is"),
        ({"spacing": np.nan}, "spacing is"),
        ({"heights": np.zeros((1, 3))}, "heights has shape"),
        ({"heights": np.array([[0, 0], [0, np.inf]])}, r"heights\[1, 1\] is inf"),
    ],
)
def test_bad_surfaces_are_refused_by_name(field, message):
    with pytest.raises(ValueError, match=message):
        Surface(**({"stiffness": 100.0} | field))


def test_bad_grips_are_refused_by_name(probe):
    with pytest.raises(ValueError, match="squeeze is"):
        HeldProbe(probe._feedback, probe._angles, UP, squeeze=0.0)
    with pytest.raises(ValueError, match="fingers has 'tail'"):
        HeldProbe(probe._feedback, probe._angles, UP, fingers=("thumb", "tail"))


@pytest.mark.parametrize("weber", [0.1, 0.2])
def test_discrimination_of_stiffness_finds_the_observers_weber_fraction(probe, weber):
    """An observer compares felt stiffness, not the surface's; the fraction lies within the interval of the analysis."""
    depth, reference = 2e-3, 300.0
    levels = np.array([0.05, 0.1, 0.2, 0.3, 0.5])

    def felt_stiffness(stiffness):
        given, is_rendered = render(probe.torques(Surface(stiffness).force(np.array([0, 0, -depth]), STILL)))
        return probe.felt_force(given, UP, is_rendered) / depth

    base = felt_stiffness(reference)
    felt_levels = np.array([felt_stiffness(reference * (1 + level)) / base - 1 for level in levels])
    hits = simulated_hits(Observer(weber), base, felt_levels, 200, 1, np.random.default_rng(3))[0]
    trials = np.full(len(levels), 200)
    result = threshold(Counts(levels, hits, trials), model=Model(PsychometricShape.DIFFERENCE, lapse=(0.0, 0.0)))
    assert result.low <= weber <= result.high and result.high - result.low < weber
