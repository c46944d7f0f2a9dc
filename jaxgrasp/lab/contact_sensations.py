"""Vibration and warmth from the contacts of the virtual hand: sensory substitution in the haptic loop."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from jaxgrasp.glove.loop.exchange import TorqueLaw
from jaxgrasp.glove.substitution import Substitution, finger_contacts, finger_indices, finger_saturation
from jaxgrasp.lab.haptic_loop import HandHaptics
from jaxgrasp.model.hand import Link, Pose


class ContactSensations:
    """Haptics whose torque laws carry sensations too, driven by ``tick`` as the haptics themselves."""

    def __init__(self, haptics: HandHaptics, substitution: Substitution) -> None:
        """Wrap a hand in a glove.

        Args:
            haptics: whose contacts are felt; those of the palm are left out.
            substitution: law from contacts to sensations, of fingers that do not touch yet.
        """
        self.haptics, self._substitution = haptics, substitution
        self._limits = np.array(haptics.model.limits)
        self._fingers = _fingers(haptics.links)

    def tick(self, timestamp: float, angles: Float[np.ndarray, "channels"], wrist: Pose) -> TorqueLaw:
        """Compute the law as by [`jaxgrasp.lab.HandHaptics`][], with the sensations of its contacts."""
        law = self.haptics.tick(timestamp, angles, wrist)
        if not law.is_valid:
            return law
        forces, normals = self.haptics.contact_forces()
        n_objects = len(forces) // len(self._fingers)
        friction = self._substitution.law.friction
        fingers = np.tile(self._fingers, n_objects)
        normal_forces, margins = finger_contacts(forces, normals, fingers, friction)
        saturation = finger_saturation(law.torques, self._limits, self.haptics.model.joints)
        return replace(law, sensations=self._substitution.step(timestamp, normal_forces, margins, saturation))


def _fingers(links: tuple[Link, ...]) -> np.ndarray:
    """Return the index of each link's finger; -1 for the palm's, whose names begin with a finger's too."""
    is_palm = np.array([link.phalanx in ("palm", "heel") for link in links])
    return np.where(is_palm, -1, finger_indices(tuple(link.name for link in links)))
