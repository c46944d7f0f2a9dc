"""Contacts of the virtual hand become sensations of each finger: by slip, onset and cut torques; the palm's do not."""

from dataclasses import replace

import numpy as np
import pytest

from jaxgrasp.glove.model import GloveModel, lrp_hand_master
from jaxgrasp.glove.substitution import Substitution, SubstitutionLaw
from jaxgrasp.grip.scene_file import load_scene, scene_path
from jaxgrasp.hand import human_hand
from jaxgrasp.lab.contact_sensations import ContactSensations
from jaxgrasp.lab.haptic_loop import HandHaptics, Haptics, pose_at, torque_law
from jaxgrasp.lab.loaded_scene import loaded_scene

LINKS = human_hand().links
NAMES = [link.name for link in LINKS]


class Given(HandHaptics):
    """Haptics of two objects whose forces a test sets."""

    model = GloveModel("two", ("index MP", "ring MP"), (0.1, 0.0))
    glove = followed = links = None

    def __init__(self):
        self.links = LINKS
        self.forces, self.normals = np.zeros((2 * len(LINKS), 3)), np.zeros((2 * len(LINKS), 3))
        self.normals[:, 2] = 1.0
        self.torques, self.is_valid = np.zeros(2), True

    def press(self, link: str, force, an_object: int = 0) -> None:
        self.forces[an_object * len(LINKS) + NAMES.index(link)] = force

    def contact_forces(self):
        return self.forces, self.normals

    def compute_torques(self, dt, smoothing, angles, wrist):
        raise NotImplementedError

    def tick(self, timestamp, angles, wrist):
        law = torque_law(timestamp, angles, (self.torques, np.zeros((2, 2))))
        return replace(law, is_valid=self.is_valid)


def felt(haptics: Given, at: float = 10.0) -> np.ndarray:
    """Amplitudes long after the fingers touched."""
    sensations = ContactSensations(haptics, Substitution(SubstitutionLaw(friction=0.5)))
    for timestamp in (0.0, at):
        law = sensations.tick(timestamp, np.zeros(2), pose_at(np.zeros(3)))
    return law.sensations.amplitudes


def test_each_finger_feels_the_slip_of_all_its_links_on_all_objects():
    haptics = Given()
    haptics.press("thumb distal", [0.5, 0.0, 1.0])
    haptics.press("index distal", [0.0, 0.0, 2.0])
    haptics.press("index middle", [0.0, 0.85, 0.0], an_object=1)
    haptics.press("little proximal", [0.0, 0.2, 1.0])
    haptics.press("middle palm", [5.0, 0.0, 1.0])
    # Margins 0 at the cone, 1 - 0.85 / (0.5 x 2) = 0.15 of the index finger as a whole, and 0.6.
    np.testing.assert_allclose(felt(haptics), [1.0, 0.5, 0.0, 0.0, 0.0], atol=1e-12)


def test_a_torque_that_a_motor_cannot_give_is_felt_and_one_without_a_motor_is_not():
    haptics = Given()
    haptics.press("index distal", [0.0, 0.0, 1.0])
    haptics.press("ring distal", [0.0, 0.0, 1.0])
    haptics.torques = np.array([0.2, 0.2])
    np.testing.assert_allclose(felt(haptics), [0.0, 0.25, 0.0, 0.0, 0.0], atol=1e-12)
    haptics.is_valid = False
    assert not felt(haptics).any()


@pytest.mark.slow
@pytest.mark.parametrize("scene", ["cylinder", "stack"])
def test_a_hand_that_closes_begins_to_feel_where_it_touches(scene):
    from jaxgrasp.lab.world_haptics import WorldHaptics
    from jaxgrasp.world.quasi_static import QuasiStaticEngine
    from jaxgrasp.world.world_file import world_of

    file, model = load_scene(scene_path(scene)), lrp_hand_master()
    gripped = loaded_scene(file)
    closed = np.asarray(gripped.closed.angles)
    if file.other:
        world, state = world_of(file, gripped)
        haptics = WorldHaptics(world, model, closed, state, QuasiStaticEngine(world, state))
    else:
        haptics = Haptics(gripped.scene, model, closed, gripped.placed)
    forces, _ = haptics.contact_forces()
    assert not forces.any() and len(forces) == len(LINKS) * (1 + len(file.other))
    sensations = ContactSensations(haptics, Substitution(SubstitutionLaw(friction=file.object.friction)))
    channels = list(model.joint_indices(gripped.scene.hand.joints))
    amplitudes = []
    for k in range(40):
        share = min(k / 20, 1.0)
        angles = (np.asarray(gripped.open) + share * (closed - np.asarray(gripped.open)))[channels]
        law = sensations.tick(0.01 * k, angles, pose_at(np.zeros(3)))
        assert law.is_valid
        amplitudes.append(law.sensations.amplitudes)
    amplitudes = np.array(amplitudes)
    assert not amplitudes[:5].any(), "an open hand is silent"
    assert (amplitudes.max(0) >= 0.5).sum() >= 2 and amplitudes.max() <= 1
