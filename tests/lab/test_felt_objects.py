"""Stimuli that a hand feels in experiments: torques as the work's derivative, their limits, and their rendering."""

import os
import time

import jax
import numpy as np
import pytest

from jaxgrasp.glove.loop.glove_process import GloveProcess
from jaxgrasp.glove.model import GloveModel, lrp_hand_master
from jaxgrasp.glove.simulated.simulator import Simulator
from jaxgrasp.lab.felt_objects import ENGAGED, SQUEEZED, TRAVEL, felt_object, resistance_and_slope, resistances
from jaxgrasp.lab.stimuli import GloveStimulus, PredictedGloveStimulus
from jaxgrasp.psychophysics.plan import FIG_8, Plan, StimulusPlan
from jaxgrasp.psychophysics.trial import NotFeltError, Rendered, StimulusLostError

MODEL = lrp_hand_master()
ALL_FOUR = ("index", "middle", "ring", "little")
FINGERS = pytest.mark.parametrize("fingers", [("index", "middle"), pytest.param(ALL_FOUR, marks=pytest.mark.slow)])


@pytest.mark.slow
@FINGERS
def test_a_weight_is_felt_by_the_work_that_lifts_it(fingers):
    """Torques = weight x d height / d angle, over the whole travel: virtual work, without any forces."""
    stimulus_object = felt_object(StimulusPlan("weight", fingers), MODEL)
    postures = stimulus_object.postures()
    heights = np.array([stimulus_object.height(posture) for posture in postures])
    assert len(postures) > 20 and heights.min() >= ENGAGED and heights.max() == pytest.approx(TRAVEL, abs=1e-3)
    rates = jax.vmap(jax.grad(stimulus_object.height))(postures)
    np.testing.assert_allclose(resistances(stimulus_object, postures, 2.0), 2.0 * np.asarray(rates), atol=1e-12)
    for name, column in zip(MODEL.joints, np.asarray(rates).T):
        assert np.any(column > 1e-3) == (name.split()[0] in fingers), name


@pytest.mark.slow
@FINGERS
def test_a_stiffness_is_felt_by_its_energy(fingers):
    stimulus_object = felt_object(StimulusPlan("stiffness", fingers), MODEL)
    postures = stimulus_object.postures()
    assert np.max([stimulus_object.depths(posture).max() for posture in postures]) == pytest.approx(SQUEEZED, abs=1e-3)

    def energy(angles):
        return 0.5 * 200.0 * jax.numpy.sum(jax.numpy.maximum(stimulus_object.depths(angles), 0) ** 2)

    expected = jax.vmap(jax.grad(energy))(postures)
    np.testing.assert_allclose(resistances(stimulus_object, postures, 200.0), expected, atol=1e-10)


def test_nothing_is_felt_before_it_is_touched_and_the_end_stops():
    stimulus_object = felt_object(StimulusPlan("weight", FIG_8), MODEL)
    start = np.asarray(stimulus_object.start)
    np.testing.assert_allclose(stimulus_object.resistance(start, 3.0), 0, atol=1e-15)
    past = start + np.array([1.2 if name in ("index MP", "middle MP") else 0.0 for name in MODEL.joints])
    assert stimulus_object.height(past) > TRAVEL and np.max(stimulus_object.resistance(past, 0.1)) > 0.5
    squeezed = felt_object(StimulusPlan("stiffness"), MODEL)
    np.testing.assert_allclose(squeezed.resistance(squeezed.start, 300.0), 0, atol=1e-15)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["weight", "stiffness", "torque"])
def test_slope(kind):
    stimulus_object = felt_object(StimulusPlan(kind), MODEL)
    postures = stimulus_object.postures()
    angles = postures[len(postures) // 2]
    torques, slope = resistance_and_slope(stimulus_object, angles, 1.5)
    np.testing.assert_allclose(torques, stimulus_object.resistance(angles, 1.5), atol=1e-14)
    backward = jax.jacrev(stimulus_object.resistance)(angles, 1.5)
    np.testing.assert_allclose(slope, backward, atol=1e-11)


def test_saturation_is_predicted():
    """On the paper's two fingers, all of 3 N: 0.12 N.m at 8.9 cm are 2.7 N on them."""
    paper = StimulusPlan("weight", FIG_8)
    stimulus = PredictedGloveStimulus(felt_object(paper, MODEL), MODEL)
    predictions = [stimulus.predict(intensity) for intensity in Plan().intensities()]
    assert [prediction.intensity for prediction in predictions if prediction.saturated] == pytest.approx(
        [3.0, 3.15, 3.3, 3.6, 3.9]
    )
    for prediction in predictions:
        assert prediction.torque == pytest.approx(
            prediction.intensity * predictions[0].torque
        ) and prediction.saturated == (prediction.torque > 0.12)
        assert (prediction.felt_intensity < prediction.intensity) == prediction.saturated
    assert np.all(np.diff([prediction.felt_intensity for prediction in predictions]) > 0)
    twice = GloveModel("strong", MODEL.joints, (0.24,) * 14)
    assert not PredictedGloveStimulus(felt_object(paper, twice), twice).predict(3.9).saturated


def test_the_default_plan_is_rendered_whole():
    stimulus = PredictedGloveStimulus(felt_object(Plan().stimulus, MODEL), MODEL)
    assert not any(stimulus.predict(intensity).saturated for intensity in Plan().intensities())


@pytest.mark.slow
@pytest.mark.parametrize("phalanx, most", [("distal", 2.71), ("middle", 3.56), ("proximal", 8.71)])
def test_nearer_to_the_knuckles_the_same_torque_bears_more(phalanx, most):
    """The torque of a joint is the weight times the rate at which the bar rises with it (virtual work)."""
    stimulus_object = felt_object(StimulusPlan("weight", FIG_8, phalanx=phalanx), MODEL)
    rates = np.asarray(jax.vmap(jax.grad(stimulus_object.height))(stimulus_object.postures()))
    assert PredictedGloveStimulus(stimulus_object, MODEL).predict(1.0).torque == pytest.approx(rates.max(), rel=1e-6)
    assert 0.12 / rates.max() == pytest.approx(most, rel=0.01)


def test_a_torque_is_one_joints():
    stimulus_object = felt_object(StimulusPlan("torque", joint="middle PIP"), MODEL)
    torques = stimulus_object.resistance(np.zeros(14), 0.05)
    assert np.flatnonzero(torques).tolist() == [MODEL.joints.index("middle PIP")] and torques.max() == 0.05


def test_what_a_glove_has_not():
    small = GloveModel("small", ("index MP",), (0.12,))
    with pytest.raises(ValueError, match=r"fingers\[1\] is 'middle': small does not pull on its MP joint"):
        felt_object(StimulusPlan("weight"), small)
    with pytest.raises(ValueError, match="joint is 'middle PIP', which small does not pull on"):
        felt_object(StimulusPlan("torque", joint="middle PIP"), small)


@pytest.mark.skipif(os.name != "posix", reason="the simulated glove needs pseudo-terminals")
def test_felt_in_a_glove():
    stimulus_object = felt_object(StimulusPlan("torque", joint="index MP"), MODEL)
    place = MODEL.joints.index("index MP")
    with Simulator() as simulator, GloveProcess(simulator.port, 14, scale=1.0, ramp=0.05, oldest=0.05) as glove:
        stimulus = GloveStimulus(stimulus_object, MODEL, glove)
        try:
            with pytest.raises(OSError, match="the glove is not armed"):
                stimulus.begin(0.05)
            assert not stimulus.is_lost(), "none has begun"
            outcome = felt_until(glove, stimulus, 0.05, lambda: reaches(glove, place, 0.05))
            assert outcome.torque == 0.05 and not outcome.saturated and outcome.felt_intensity == 0.05
            assert reaches(glove, place, 0.0)
            outcome = felt_until(glove, stimulus, 0.2, lambda: reaches(glove, place, 0.12))
            assert outcome.saturated and outcome.felt_intensity == pytest.approx(0.12)
            arm(glove, stimulus)
            stimulus.begin(0.05)
            glove.disarm()
            assert reaches(glove, place, 0.0)
            assert becomes_lost(stimulus), "so that whoever is asked is told"
            with pytest.raises(StimulusLostError, match="the glove released during the stimulus"):
                stimulus.end()
            # What nobody is there to render is not felt, whatever was said last.
            arm(glove, stimulus)
            stimulus.begin(0.05)
            glove.child.process.kill()
            assert becomes_lost(stimulus)
            with pytest.raises(StimulusLostError, match="the glove released during the stimulus"):
                stimulus.end()
            with pytest.raises(StimulusLostError, match="the glove is not armed"):
                stimulus.begin(0.05)
        finally:
            stimulus.close()


@pytest.mark.slow
@pytest.mark.realtime
@pytest.mark.skipif(os.name != "posix", reason="the simulated glove needs pseudo-terminals")
def test_a_weight_is_felt_in_a_glove_where_it_is_lifted():
    """At whatever angles its person bends to, the glove holds the torques of the work that lifts it; below it, none."""
    stimulus_object = felt_object(StimulusPlan("weight", FIG_8), MODEL)
    lifted = stimulus_object.postures()[30]
    with Simulator() as simulator, GloveProcess(simulator.port, 14, scale=1.0, ramp=0.05, oldest=0.05) as glove:
        stimulus = GloveStimulus(stimulus_object, MODEL, glove)
        try:
            # Fingers come to rest within 2 mrad of where they are bent to, by the cables' friction: below the bar.
            below = np.asarray(stimulus_object.start) - 0.01
            assert float(stimulus_object.height(below + 0.002)) < 0
            bent(simulator, below)
            with pytest.raises(NotFeltError, match="no finger felt the stimulus"):
                felt_until(glove, stimulus, 2.0, lambda: any(follows(glove, stimulus_object) for _ in range(300)))
            bent(simulator, lifted)
            outcome = felt_until(glove, stimulus, 2.0, lambda: any(follows(glove, stimulus_object) for _ in range(300)))
            assert not outcome.saturated and outcome.felt_intensity == 2.0
            assert outcome.torque > 0.07
            # The end of the travel is no part of the weight, however hard it is.
            past = lifted + 0.4 * (lifted != np.asarray(stimulus_object.start))
            outcome = felt_until(glove, stimulus, 2.0, lambda: bent(simulator, past))
            assert stimulus_object.height(past) > TRAVEL and not outcome.saturated and outcome.felt_intensity == 2.0
        finally:
            stimulus.close()


def becomes_lost(stimulus: GloveStimulus) -> bool:
    """Return True once the stimulus is lost, within 0.3 s."""
    end = time.perf_counter() + 0.3
    while not (is_lost := stimulus.is_lost()) and time.perf_counter() < end:
        time.sleep(0.01)
    return is_lost


def bent(simulator: Simulator, posture: np.ndarray) -> bool:
    """Bend the person's hand to the posture; return True once it is there."""
    simulator.order(bend=posture.tolist(), lasts=0.2)
    time.sleep(0.5)
    return True


def follows(glove: GloveProcess, stimulus_object) -> bool:
    """Return True where torques are those of 2 N at the measured angles, up to the angles' latest motion."""
    time.sleep(0.01)
    state = glove.state()
    # Compiled already: anything slower would hold up the laws beside it.
    expected = np.asarray(resistance_and_slope(stimulus_object, state.angles, 2.0)[0])
    return bool(np.max(np.abs(state.torques - np.clip(expected, 0, None))) < 1e-3)


def felt_until(glove: GloveProcess, stimulus: GloveStimulus, intensity: float, is_so) -> Rendered:
    """Feel an intensity until ``is_so`` holds and return the outcome; retry where a busy machine ended torque."""
    for _ in range(10):
        try:
            arm(glove, stimulus)
            stimulus.begin(intensity)
            so = is_so()
            outcome = stimulus.end()
        except NotFeltError:
            raise
        except StimulusLostError:
            continue
        assert so
        return outcome
    raise AssertionError("the glove let go ten times")


def arm(glove: GloveProcess, stimulus: GloveStimulus) -> None:
    """Arm the glove, again and again where a busy machine has latched it."""
    end = time.perf_counter() + 10
    while True:
        try:
            glove.arm()
            stimulus.wait_until_armed(10.0)
            return
        except (ValueError, OSError):
            if time.perf_counter() > end:
                raise
            time.sleep(0.1)


def reaches(glove: GloveProcess, place: int, torque: float) -> bool:
    end = time.perf_counter() + 5
    while time.perf_counter() < end:
        state = glove.state()
        if state is not None and abs(state.torques[place] - torque) < 1e-4:
            return True
        time.sleep(0.01)
    return False
