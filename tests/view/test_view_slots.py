"""Frames through a shared slot, and the experiment's pages that are made from them."""

import jax
import numpy as np

from jaxgrasp.glove.loop.exchange import GloveState, Slot, TorqueLaw
from jaxgrasp.hand.to_grasp import GripType
from jaxgrasp.lab.haptic_loop import Followed
from jaxgrasp.model.hand import Pose
from jaxgrasp.psychophysics.person import SimulatedPerson
from jaxgrasp.psychophysics.psychometric import Observer
from jaxgrasp.psychophysics.session import LET_GO
from jaxgrasp.psychophysics.trial import Trial
from jaxgrasp.view.view_slots import TRIAL, Carried, TrialState, ViewFrame
from jaxgrasp.view.viewed_person import Phase, ViewedPerson, experimenter_html, subject_html

RNG = np.random.default_rng(2)
CHANNELS = 14


def ticked(more: np.ndarray) -> ViewFrame:
    angles, torques, measured = RNG.normal(size=(3, CHANNELS))
    state = GloveState(2.0, 3, 1, 0.0, 1.5, angles, torques, measured)
    law = TorqueLaw(2.0, True, angles, torques, np.zeros((CHANNELS, CHANNELS)))
    return ViewFrame.ticked(state, law, more)


def test_a_frame_goes_through_a_slot(tmp_path):
    wrist, placed = (Pose(RNG.normal(size=(*n, 3)), RNG.normal(size=(*n, 3, 3))) for n in ((), (2,)))
    grip = GripType.CYLINDRICAL_POWER
    carried = Carried.at(wrist, Followed(placed, RNG.normal(size=(2, 6)), RNG.normal(size=19), 4.0, grip))
    sent = ticked(carried.vector())
    size = ViewFrame.size(CHANNELS, Carried.size(2, 19))
    writer, reader = Slot(tmp_path / "slot", size, create=True), Slot(tmp_path / "slot", size)
    writer.write(sent.vector())
    got = ViewFrame.of(reader.read(), CHANNELS)
    assert (got.angles_at, got.link, got.guard) == (1.5, 3, 1)
    for name in ("angles", "torques", "measured", "extra"):
        np.testing.assert_array_equal(getattr(got, name), getattr(sent, name))
    back = Carried.of(got.extra, 2)
    np.testing.assert_array_equal(back.wrist, carried.wrist)
    for before, after in zip(jax.tree.leaves(carried.followed), jax.tree.leaves(back.followed), strict=True):
        np.testing.assert_array_equal(before, after)
    plain = Carried.at(wrist, carried.followed._replace(grip=None))
    assert back.followed.grip == grip and Carried.of(plain.vector(), 2).followed.grip is None
    writer.close()
    reader.close()


def test_a_trial_goes_through_a_frame():
    state = TrialState(1.0, 3.0, 40.0, 2.0, 1.25, 1.0, answered=2.0, right=1.0)
    sent = ticked(state.vector())
    assert len(state.vector()) == TRIAL
    got = TrialState.of(ViewFrame.of(sent.vector(), CHANNELS).extra)
    np.testing.assert_array_equal(got, state)


def test_the_subject_is_not_told_the_answer_and_the_experimenter_is():
    for phase in Phase:
        for first, second in ((1.23, 4.56), (4.56, 1.23)):
            state = TrialState(phase, 3, 40, 1, first, second)
            html, swapped_html = (
                subject_html(state, "weight"),
                subject_html(state._replace(first=second, second=first), "weight"),
            )
            # Nothing that is said hangs on what is rendered.
            assert html == swapped_html and "1.23" not in html
            experimenter_page = experimenter_html(state, "weight")
            assert (
                "1.23 N" in experimenter_page and ("the first" if first > second else "the second") in experimenter_page
            )
    assert "Which one was stiffer" in subject_html(TrialState(Phase.CHOOSES, 3, 40), "stiffness")


def test_a_persons_trial_is_shown_as_it_goes():
    person = ViewedPerson(SimulatedPerson(Observer(), 0, "a"), 40)
    trial = Trial(3, 1, 1, False, "choice", 1.0, 0.5, 1.5, 1.0)
    person.feel(trial, 2, 0.0)
    assert Phase(person.state.phase) == Phase.FEELS
    assert (person.state.number, person.state.interval, person.state.first) == (3, 2, 1.5)
    person.announce_repeat("no finger felt the stimulus")
    assert Phase(person.state.phase) == Phase.REPEATS and "does not count" in subject_html(person.state, "weight")
    person.announce_repeat(LET_GO)
    assert Phase(person.state.phase) == Phase.LOST and "you feel nothing" in subject_html(person.state, "weight")
    person.is_lost = lambda: True
    assert person._person.is_lost()
    setting = Trial(4, 1, 1, False, "setting", 1.0, 0.5, 1.0, 1.5)
    person.adjust(setting, 1.5)
    assert Phase(person.state.phase) == Phase.ADJUSTS and person.state.setting == 1.5
