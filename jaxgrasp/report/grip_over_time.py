"""A grip over time as plain arrays: what its page and its pictures draw."""

from dataclasses import dataclass, fields, replace

import numpy as np

from jaxgrasp.force.slip import friction_margin
from jaxgrasp.grip.monitor import Hold, Touch
from jaxgrasp.grip.scene import Scene
from jaxgrasp.grip.simulation import Record
from jaxgrasp.hand.kinematics import ancestry, pose_hand
from jaxgrasp.model.hand import Hand, Posture
from jaxgrasp.report.look import counted
from jaxgrasp.report.surfaces import pose_matrix

VERBS = {Touch.HOLDS: "hold", Touch.SLIDES: "slide", Touch.PULLS: "pull"}


@dataclass(frozen=True)
class History:
    """T instants of a hand of L links and J joints, in the world and in SI units; NaN is what is not known."""

    fingers: tuple[str, ...]
    """Finger of each link."""
    links: tuple[str, ...]
    joint_fingers: tuple[str, ...]
    """The finger that each joint moves."""
    joints: tuple[str, ...]
    times: np.ndarray
    link_poses: np.ndarray
    """``(T, L, 3, 4)``: rotation and, as the last column, origin."""
    object_pose: np.ndarray
    """``(T, 3, 4)``: rotation and, as the last column, origin."""
    points: np.ndarray
    """``(T, L, 3)``"""
    normals: np.ndarray
    forces: np.ndarray
    """``(T, L, 3)``: of the applied law, on the object [N]."""
    touches: np.ndarray
    """``(T, L)``: codes of Touch."""
    squeeze: np.ndarray
    """``(T, L)``: intended normal forces [N], 0 where nothing touches."""
    margins: np.ndarray
    """``(T, L)``: friction angle less slip angle [rad]; NaN where no force acts."""
    torques: np.ndarray
    """``(T, J)`` [N.m]"""
    hold: np.ndarray
    """``(T,)``: codes of Hold."""

    @property
    def drawn(self) -> np.ndarray:
        """Mask ``(T, L)`` of contacts that exist and have finite coordinates."""
        is_finite = np.isfinite(self.points).all(-1) & np.isfinite(self.normals).all(-1)
        return (self.touches != Touch.ABSENT) & is_finite

    @property
    def pressing(self) -> np.ndarray:
        """Normal components ``(T, L)`` of the forces, along the inward normals [N]."""
        return np.einsum("tli,tli->tl", self.forces, self.normals)

    def description(self, k: int) -> str:
        """Return instant k as text: the object's hold, and the numbers of contacts that hold, slide or pull."""
        title = Hold(int(self.hold[k])).name.lower()
        touches = self.touches[k][self.touches[k] != Touch.ABSENT]
        if not len(touches):
            return f"{title}: nothing touches"
        counts_by_touch = [f"{(touches == touch).sum()} {VERBS[touch]}" for touch in VERBS if (touches == touch).any()]
        return f"{title}: {counted(len(touches), 'contact')}, {', '.join(counts_by_touch)}"

    def at(self, chosen: np.ndarray) -> "History":
        """Return the history at the chosen instants, an index array or mask over T."""
        over_time = {field.name: getattr(self, field.name) for field in fields(self) if field.type is np.ndarray}
        return replace(self, **{name: array[chosen] for name, array in over_time.items()})


def history(scene: Scene, postures: Posture, times: np.ndarray, record: Record) -> History:
    """Collect the history of a grip from the postures and the stacked record of the same T instants."""
    ticks = record.tick
    margins = np.asarray(friction_margin(ticks.grasp, ticks.assessment.forces, ticks.assessment.moments))
    links = pose_hand(scene.hand, postures).links
    is_present = ticks.contacts.present > 0
    return History(
        fingers=tuple(link.finger for link in scene.hand.links),
        links=tuple(link.name for link in scene.hand.links),
        joint_fingers=_joint_fingers(scene.hand),
        joints=scene.hand.joints,
        times=np.asarray(times, float),
        link_poses=pose_matrix(links),
        object_pose=pose_matrix(record.placed),
        points=np.asarray(ticks.contacts.points),
        normals=np.asarray(ticks.contacts.normals),
        forces=np.asarray(ticks.assessment.forces),
        touches=np.asarray(ticks.assessment.touches),
        squeeze=np.where(is_present, ticks.grasp.squeeze, 0),
        margins=np.where(np.isfinite(margins), margins, np.nan),
        torques=np.asarray(ticks.torques),
        hold=np.asarray(record.hold),
    )


def _joint_fingers(hand: Hand) -> tuple[str, ...]:
    moves = ancestry(hand)
    return tuple(hand.links[int(moves[:, j].argmax())].finger for j in range(len(hand.joints)))
