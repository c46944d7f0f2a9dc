"""A weight by the hand's whole pipeline: judged by work, by Newton's law, and by the exact law beside it."""

import numpy as np
import pytest

from jaxgrasp.glove.model import lrp_hand_master
from jaxgrasp.grip.table_support import FADE
from jaxgrasp.lab.felt_objects import TRAVEL, LawOfAngles, felt_object, resistances
from jaxgrasp.lab.simulated_weight import CarriedPlate, G, rendering_of
from jaxgrasp.lab.stimuli import PredictedGloveStimulus
from jaxgrasp.psychophysics.plan import FIG_8, StimulusPlan

pytestmark = pytest.mark.slow
MODEL = lrp_hand_master()
PLAN = StimulusPlan("weight", FIG_8, rendering="simulated")


@pytest.fixture(scope="module")
def weight_object():
    return felt_object(PLAN, MODEL)


@pytest.fixture(scope="module")
def plate(weight_object) -> CarriedPlate:
    return rendering_of(PLAN, weight_object, MODEL)


def lifted(plate: CarriedPlate, intensity: float, angles: np.ndarray, dt: float) -> tuple[np.ndarray, np.ndarray, list]:
    """Lift the plate; return the torques of each tick, the plate's heights, and the ticks."""
    plate.begin(intensity)
    ticks, heights = [], []
    for k, angle in enumerate(angles):
        ticks.append(plate.tick(dt * k, angle))
        heights.append(float(plate._haptics.placed.origin[2]))
    return np.array([tick.law.torques for tick in ticks]), np.array(heights), ticks


def alone(ticks: list) -> np.ndarray:
    """Return True for the ticks before the stop is met."""
    return np.array([tick.is_alone for tick in ticks])


def test_a_plate_is_lifted_by_the_work_of_the_joints(weight_object, plate):
    """Slowly: what the joints work is what the weight gains in height."""
    postures = weight_object.postures()
    torques, heights, ticks = lifted(plate, 2.0, postures, 0.05)
    postures, torques, heights = (array[alone(ticks)] for array in (postures, torques, heights))
    between = (torques[1:] + torques[:-1]) / 2
    work = np.sum(between * np.diff(postures, axis=0))
    assert heights[-1] - heights[0] > 0.03
    assert work == pytest.approx(2.0 * (heights[-1] - heights[0]), rel=0.02)
    assert ticks[-1].share == 1.0 and all(tick.law.is_valid for tick in ticks)
    bears = [name.split()[0] in FIG_8 for name in MODEL.joints]
    assert np.abs(torques[:, ~np.array(bears)]).max() < 1e-9


def test_inertia_is_felt_as_it_is_lifted_fast(weight_object, plate):
    """Torques are those of m (g + a), by the plate's own second differences, smoothed as the loop smooths them."""
    postures, dt = weight_object.postures(), 0.01
    times = dt * np.arange(16)
    path = postures[0] + (postures[-1] - postures[0]) * (times / times[-1])[:, None] ** 2
    fast, heights, _ = lifted(plate, 2.0, path, dt)
    slow, _, _ = lifted(plate, 2.0, path, 10.0)
    gained = np.diff(heights, 2)[4:-1].mean() / dt**2
    ratio = fast[8:-1].sum() / slow[8:-1].sum()
    assert gained > 1.5
    assert ratio == pytest.approx(1 + gained / G, rel=0.05)


def test_torques_are_in_proportion_to_the_weight_and_near_the_exact_law(weight_object, plate):
    postures = weight_object.postures()
    torques, heights, ticks = lifted(plate, 1.0, postures, 0.05)
    three, _, _ = lifted(plate, 3.0, postures, 0.05)
    np.testing.assert_allclose(plate.predicted_torques(3.0), 3 * torques[alone(ticks)], atol=1e-12)
    # Nothing rests on what it lay on any more.
    chosen = alone(ticks) & (heights - heights[0] > FADE)
    postures, torques, three = (array[chosen] for array in (postures, torques, three))
    assert len(postures) > 80
    np.testing.assert_allclose(three, 3 * torques, atol=2e-4)
    exact = np.asarray(resistances(weight_object, postures, 1.0))
    exact_object = felt_object(StimulusPlan("weight", FIG_8), MODEL)
    high = np.array([float(exact_object.share(angles)) for angles in postures]) == 1
    # All of the weight in both: what differs is which finger has how much of it, and where.
    assert torques[high].sum() == pytest.approx(exact[high].sum(), rel=0.15)


def test_nothing_is_felt_of_nothing_and_the_way_has_an_end(weight_object, plate):
    start = np.asarray(weight_object.start)
    plate.begin(0.0)
    assert not np.any(plate.tick(0.0, start).law.torques)
    past = start + np.array([0.8 if name in ("index MP", "middle MP") else 0.0 for name in MODEL.joints])
    path = start + np.linspace(0, 1, 120)[:, None] * (past - start)
    torques, heights, ticks = lifted(plate, 0.5, path, 0.05)
    assert heights[-1] - heights[0] > TRAVEL and not ticks[-1].is_alone
    free = max(k for k, tick in enumerate(ticks) if tick.is_alone)
    assert torques[-1].max() > 3 * torques[free].max()


def test_a_plan_says_which(weight_object, plate):
    assert isinstance(rendering_of(StimulusPlan("weight"), weight_object, MODEL), LawOfAngles)
    predicted = PredictedGloveStimulus(weight_object, MODEL, plate).predict(1.0)
    by_law = PredictedGloveStimulus(weight_object, MODEL).predict(1.0)
    # Of two fingers one bears more, and none bears more than all of it.
    assert by_law.torque < predicted.torque < 2 * by_law.torque and not predicted.saturated
    with pytest.raises(ValueError, match="rendering is 'simulated': expected 'exact' of a torque"):
        StimulusPlan("torque", rendering="simulated")
