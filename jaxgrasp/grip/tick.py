"""One instant of the paper's loop: posture to contacts, forces by method B and its optimum, joint torques."""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jax import Array

from jaxgrasp.grip.contact_forces import ContactForces, cut_to_cones
from jaxgrasp.grip.monitor import Assessment, Hold, Law
from jaxgrasp.grip.motion import Motion, guide_at
from jaxgrasp.grip.obstacles import hand_torques, obstacle_contacts, spring_wrench, world_wrench
from jaxgrasp.grip.scene import Scene, at_time, check_scene
from jaxgrasp.grip.table_support import STANDING, Solutions, TableFriction, held_beside_table
from jaxgrasp.hand.detection import Contacts, find_contacts
from jaxgrasp.hand.kinematics import joint_torques, pose_hand
from jaxgrasp.hand.to_grasp import grasp_about
from jaxgrasp.model.arrays import AnyArray, Bool, Float
from jaxgrasp.model.grasp import Grasp
from jaxgrasp.model.hand import HandFrames, Pose, Posture
from jaxgrasp.model.wrench import weight_wrench
from jaxgrasp.validation.checked import checked


class Touches(NamedTuple):
    """Contacts of a hand with the object and its surroundings. Any leading axes."""

    contacts: Contacts
    """Contacts with the object, in the world."""
    grasp: Grasp
    """Grasp of these contacts, in a frame at the object's centre, along the world's axes."""
    blocked: Float[Array, "*batch J"]
    """Joint torques from the table and obstacles that the hand itself touches [N.m]."""


class ContactMemory(NamedTuple):
    """Forces and motion at contacts in one step that the next one continues from."""

    drift: Motion
    """Velocity of the object relative to the hand that holds it."""
    friction: TableFriction
    resistance: Float[Array, "6"]
    """Wrench of friction and damping of obstacles about the object's centre [N, N.m]."""


def no_memory() -> ContactMemory:
    """Return the memory of an object at rest."""
    return ContactMemory(Motion(jnp.zeros(3), jnp.zeros(3)), TableFriction(jnp.zeros(6), jnp.zeros(())), jnp.zeros(6))


class StepResult(eqx.Module):
    """Contacts, forces, assessment and joint torques of one instant. Any leading axes."""

    contacts: Contacts
    grasp: Grasp
    """Grasp in a frame at the object's centre, along the world's axes."""
    stiffness: Float[Array, "*batch L"]
    """Effective stiffness of each contact, c K of eq. 6 [N/m], by which its squeezing force grows with depth; 0 without
    contact."""
    wrench: Float[Array, "*batch 6"]
    """Wrench required of hand and table about that centre [N, N.m]."""
    inertial: Float[Array, "*batch 6"]
    """Part of the wrench that accelerates the object."""
    assessment: Assessment
    """Assessment of the hand alone, as if the object were clear of the table."""
    support: Float[Array, "*batch 6"]
    """Part of the wrench that the table exerts [N, N.m]; zero where the object is clear of it."""
    rests: Bool[Array, "*batch"]
    """True if the object stands on the table and stays there, though the hand alone does not hold it."""
    exerted: Float[Array, "*batch L 3"]
    """Forces of the hand on the object [N]: beside the support, the applied law's forces where it holds or the object
    rests; each cut to its friction where it slips. Where no allowed forces hold, [`jaxgrasp.reachable_wrench`][] has
    the closest feasible ones."""
    moments: Float[Array, "*batch L"] | None
    """Moments of soft fingers about their normals, with these forces [N.m]; None where all contacts are hard."""
    torques: Float[Array, "*batch J"]
    """Joint torques from all contacts [N.m], those with table and obstacles too: negative where they resist a positive
    angle."""
    blocked: Float[Array, "*batch J"]
    """Part of the torques from table and obstacles [N.m]."""
    table_points: Float[Array, "*batch s 3"]
    """Support points on the table from the object's centre, along the world's axes [m]; none among several objects."""
    table_pressed: Float[Array, "*batch s"]
    """Normal forces of the table at these points [N]."""

    @property
    def slips(self) -> Bool[Array, "*batch"]:
        """Return whether the object slips through the hand, and does not rest on the table."""
        return (self.assessment.hold == Hold.SLIPPING) & ~self.rests

    @property
    def by_hand(self) -> ContactForces:
        """Return forces and moments of the hand."""
        return ContactForces(self.exerted, self.moments)

    def left_by(self, exerted: ContactForces) -> Float[Array, "*batch 6"]:
        """Compute the part of the wrench that the hand's forces and moments and the table's support leave [N, N.m]."""
        return self.wrench - self.support - exerted.wrench(self.grasp)


@checked
def observe(
    scene: Scene,
    posture: Posture,
    placed: Pose,
    inertial: Float[AnyArray, "*#batch 6"] | None = None,
    *,
    law: Law = "closed-form",
    time: Float[AnyArray, ""] | float = 0.0,
    motion: Motion | None = None,
    memory: ContactMemory | None = None,
) -> StepResult:
    """Compute one instant of the paper's loop: posture to contacts, forces by method B and its optimum, joint torques.

    Args:
        scene: hand, object, and the laws of their contacts.
        posture: posture of the hand; any leading axes.
        placed: pose of the object; leading axes that broadcast.
        inertial: wrench about the object's centre that accelerates it, beside its weight [N, N.m]; none at rest.
        law: force law of the hand, as for [`jaxgrasp.grip.monitor`][].
        time: time at which the paths of obstacles are evaluated [s].
        motion: motion of the object, which obstacles with friction or damping resist; at rest where not given.
        memory: friction and damping of table and obstacles at the step before, which applies in place of that by
            ``motion``; that of an object at rest where not given.

    Returns:
        A StepResult, with contacts in the world, its grasp and wrench about the object's centre, along the world's
        axes.

    Raises:
        ValueError: for an invalid guide, and obstacles without the object's outline.
    """
    check_scene(scene)
    scene = at_time(scene, time)
    touches = find_touches(scene, posture, placed)
    return assess_touches(scene, pose_hand(scene.hand, posture), placed, touches, inertial, law, motion, memory)[0]


def find_touches(scene: Scene, posture: Posture, placed: Pose) -> Touches:
    """Find the contacts of the hand, with obstacles at their poses in the scene."""
    contacts = find_contacts(scene.hand, posture, scene.body.shape, placed)
    return touches_of(scene, placed, contacts, hand_torques(scene, posture))


def touches_of(scene: Scene, placed: Pose, contacts: Contacts, blocked: Float[Array, "*batch J"]) -> Touches:
    """Build Touches from the contacts with the object and the torques by table and obstacles."""
    friction, stiffness, contributions, torsion = scene.friction, scene.stiffness, scene.contributions, scene.torsion
    return Touches(contacts, grasp_about(placed.origin, contacts, friction, stiffness, contributions, torsion), blocked)


def assess_touches(
    scene: Scene,
    frames: HandFrames,
    placed: Pose,
    touches: Touches,
    inertial: Float[AnyArray, "*#batch 6"] | None,
    law: Law,
    motion: Motion | None = None,
    memory: ContactMemory | None = None,
    known: Solutions | None = None,
) -> tuple[StepResult, Solutions]:
    """Compute forces, assessment and joint torques for detected contacts, and the solutions of the force problems.

    With ``known`` solutions, of an earlier call with these arguments, only derivatives are computed.
    """
    contacts, grasp, blocked = touches
    weight = weight_wrench(scene.body.mass, jnp.zeros(3), scene.gravity)
    wrench = jnp.broadcast_to(weight, (*contacts.tests.shape, 6))
    inertial = jnp.broadcast_to(jnp.zeros(6) if inertial is None else inertial, wrench.shape)
    # w = -m g + M a - w_obstacles
    wrench = wrench + inertial
    if scene.obstacles and memory is None:
        wrench = wrench - world_wrench(scene, placed, motion)
    elif scene.obstacles and memory is not None:
        wrench = wrench - spring_wrench(obstacle_contacts(scene, placed), placed) - memory.resistance
    free = None if scene.guide is None else guide_at(scene.guide, placed.origin)
    friction = None if memory is None else memory.friction
    assessment, table, solutions = held_beside_table(
        scene, placed, grasp, wrench, inertial, free, law=law, friction=friction, known=known
    )
    slips = assessment.hold == Hold.SLIPPING
    hand_forces = cut_to_cones(grasp, assessment.exerted).where(slips, assessment.exerted)
    # The object stays on the table, unless the hand that does not hold it lifts it by more than its weight, if askew.
    up = jnp.asarray(scene.table.rotation)[:, 2]
    lifts = slips & (jnp.sum(hand_forces.forces, -2) @ up > (wrench - inertial)[..., :3] @ up)
    share = jnp.where(lifts, 0, table.share)
    exerted = hand_forces.towards(table.exerted, share)
    couples = exerted.couples(grasp)
    torques = joint_torques(scene.hand, frames, contacts.points, exerted.forces, couples) + blocked
    rests = slips & (share > STANDING)
    support = share[..., None] * table.wrench
    stiffness = contacts.present * scene.contributions * scene.stiffness
    result = StepResult(
        contacts=contacts,
        grasp=grasp,
        stiffness=stiffness,
        wrench=wrench,
        inertial=inertial,
        assessment=assessment,
        support=support,
        rests=rests,
        exerted=exerted.forces,
        moments=exerted.moments,
        torques=torques,
        blocked=blocked,
        table_points=table.points,
        table_pressed=share[..., None] * table.pressed,
    )
    return result, solutions
