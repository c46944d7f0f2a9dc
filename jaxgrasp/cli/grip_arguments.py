"""Arguments of ``jaxgrasp grip``."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal


@dataclass(frozen=True)
class Grip:
    """Close the virtual hand on an object, lift it, turn it, and write contacts, forces, verdicts and torques.

    grip.npz holds arrays over time: points, normals, depths, forces and squeeze by `links`, angles and torques by
    `joints` (what resists flexion is negative). Points, normals, forces and poses are in the world, wrench and missed
    about the object's centre. Codes are those of jaxgrasp.grip.Hold, Touch, GripType and Verdict.
    """

    scene: str | None = None
    """TOML file of a scene, or the name of a ready one (`jaxgrasp scene list`): it has the hand, the object, the
    grip and its law, and the options for these have no effect."""
    engine: Literal["quasi-static", "mujoco"] | None = None
    """Engine that moves the objects of a scene with others beside the gripped one: our own, the default, or MuJoCo's
    (needs the extra `hands`)."""
    object: Literal["cylinder", "sphere", "capsule", "box"] = "cylinder"
    """Shape of the gripped object; in a power grip it lies across the palm."""
    grip: Literal["power", "precision-3", "precision-5"] = "power"
    """All of the hand around the object; or three or five fingertips, the thumb's opposite the others."""
    radius: float = 0.03
    """Radius of the object [m]; half the edge of a box."""
    height: float = 0.12
    """Height of a cylinder, of a capsule's straight part, or of a box [m]."""
    mass: float = 0.4
    """Mass of the object [kg]."""
    friction: float = 0.6
    """Coulomb's coefficient at every contact."""
    stiffness: float = 1000.0
    """K [N/m] of the paper's eq. 6: a contact's squeeze is K times its depth times its link's contribution."""
    contributions: Literal["table", "balanced"] = "table"
    """Contributions of the links: the paper's Table I, where it has them; or the nearest to it by which the squeezing
    forces balance, so that the closed form stays inside the friction cones."""
    depth: float = 2e-3
    """Depth to which the links press into the object [m]."""
    hand_length: float = 0.19
    """Length of the hand, from the wrist to the middle finger's tip [m]."""
    side: Literal["right", "left"] = "right"
    """Side of the hand."""
    lift: float = 0.2
    """Height by which the hand rises [m]."""
    turn: float = 90.0
    """Angle by which it then turns about its own length, by the right-hand rule about the wrist's x [degrees]."""
    release: bool = False
    """Open the hand at the end."""
    seconds: float = 4.0
    """Duration, a quarter each to hold, lift, turn, and hold or let go [s]; in a short time inertia weighs more."""
    step: float = 0.02
    """Time from one instant to the next [s]."""
    law: Literal["closed-form", "optimum"] = "optimum"
    """Law of the forces that decide whether the object slips; the paper's are the closed form, jaxgrasp.grip.simulate's
    default."""
    report: bool = True
    """Write grip.html, grip.png and grip_forces.png beside the results (needs the extra `report`)."""
    out: Path = Path("jaxgrasp-grip")
    """Folder for the results."""
