"""Laws of an experiment's feedback conditions: what of a torque is rendered, and what vibrates for it."""

import numpy as np
import pytest

from jaxgrasp.glove import TorqueLaw, lrp_hand_master
from jaxgrasp.glove.substitution import FINGERS, torque_amplitudes
from jaxgrasp.lab.stimuli import law_in_condition

MODEL = lrp_hand_master()


@pytest.mark.parametrize("condition", ["", "none", "force", "vibration", "both"])
def test_a_condition_renders_torques_vibration_both_or_neither(condition):
    rng = np.random.default_rng(2)
    torques = rng.uniform(0, 0.12, 14)
    law = TorqueLaw(1.0, True, np.zeros(14), torques, rng.normal(size=(14, 14)))
    rendered = law_in_condition(law, condition, MODEL)
    has_torque, vibrates = condition in ("", "force", "both"), condition in ("vibration", "both")
    np.testing.assert_array_equal(rendered.torques, torques if has_torque else np.zeros(14))
    np.testing.assert_array_equal(rendered.derivative, law.derivative if has_torque else np.zeros((14, 14)))
    assert rendered.sensations.amplitudes.any() == vibrates and not rendered.sensations.temperatures.any()
    assert rendered.is_valid and rendered.computed_at == 1.0


def test_amplitudes_are_each_fingers_largest_share_of_a_limit():
    limits = np.array(MODEL.limits)
    for k, joint in enumerate(MODEL.joints):
        for share in (0.0, 0.25, 1.0, 3.0):
            amplitudes = torque_amplitudes(share * limits * (np.arange(14) == k), limits, MODEL.joints)
            assert amplitudes[FINGERS.index(joint.split()[0])] == pytest.approx(min(share, 1.0))
            assert np.count_nonzero(amplitudes) == (share > 0)
    with pytest.raises(ValueError, match="torques, limits and joints have 14, 14 and 13 entries"):
        torque_amplitudes(np.zeros(14), limits, MODEL.joints[:13])
