"""The Grasp, n contacts between a hand and an object, the Limits of what the hand can exert, and the conventions.

- SI units. Points, normals and wrenches are written in one frame; a wrench is (force, torque about
  that frame's origin).
- Normals are unit vectors that point INTO the object. The paper's eq. 3 has them outward while its
  squeezing force (eq. 6) needs them inward; here they are inward throughout. Nothing can tell outward ones from an
  object that is held from inside: they give answers, with good verdicts, whose forces pull the contacts apart.
- Forces are what the hand exerts ON the object: a contact that presses has f.a > 0.
- A wrench is what the contacts must exert, w = -(F_ext, N_ext) of eq. 1, so that G f = w.
- The last axes are (contact, component); every axis before them is a batch axis.
"""

from typing import ClassVar

import equinox as eqx

from jaxgrasp.model.arrays import AnyArray, Batched, Float, Lists, from_lists

OPTIONAL = ("present", "torsion")
"""Fields of a Grasp that may be None."""


class Grasp(Batched):
    """Contacts of a hand with an object, alone or in batches (source: section II-C and eq. 6).

    Lengths are in metres, forces in newtons, all in one frame; normals point INTO the object. The last axes are
    (contact, component), any axes before them are a batch: ``len(grasps)`` counts along the first of these,
    ``grasps[3]``, ``grasps[10:20]`` or a mask take some.

    Fields are arrays; lists of numbers become such. Building one checks nothing else, so that it works under
    ``jit``, ``vmap`` and ``grad``; hand concrete data to [`jaxgrasp.check_grasp`][] first.

    Args:
        points: where the hand touches the object ``(..., n, 3)`` [m].
        normals: unit surface normals that point into the object ``(..., n, 3)``. With outward ones turn them round
            first: a grasp whose normals point out is solved as they stand, and may well be called optimal.
        friction: Coulomb coefficients mu >= 0 ``(..., n)``.
        squeeze: intended normal forces s >= 0 ``(..., n)`` [N] (eq. 6).
        present: 1 where the contact exists, 0 where it is padding ``(..., n)``; all exist where it is not given.
        torsion: torsional friction gamma >= 0 of soft fingers ``(..., n)`` [m]; all are hard where it is not given.

    Raises:
        ValueError: for nested lists that hold no numbers, or are of unequal lengths.
    """

    last_axes: ClassVar[dict[str, int]] = {
        "points": 2,
        "normals": 2,
        "friction": 1,
        "squeeze": 1,
        "present": 1,
        "torsion": 1,
    }

    points: Float[AnyArray, "*batch n 3"]
    """Where the hand touches the object [m]."""
    normals: Float[AnyArray, "*batch n 3"]
    """Unit surface normals that point into the object."""
    friction: Float[AnyArray, "*batch n"]
    """Coulomb coefficients mu >= 0."""
    squeeze: Float[AnyArray, "*batch n"]
    """Intended normal forces s >= 0 [N] (eq. 6)."""
    present: Float[AnyArray, "*batch n"] | None
    """1 where the contact exists, 0 where it is padding; ``None`` means that all exist.

    An absent contact carries exactly zero force and has zero derivative, whatever its other fields hold.
    """
    torsion: Float[AnyArray, "*batch n"] | None
    """Torsional friction gamma >= 0 [m] of soft fingers; 0 for hard ones, ``None`` means that all are hard.

    A soft finger exerts a moment m about its normal too, within |f_t|^2 / mu^2 + m^2 / gamma^2 <= (f.a)^2: friction
    resists sliding and turning together. One that has no friction has no torsional friction either.
    """

    # Rather than converters of the fields, whose shapes would go unchecked.
    def __init__(
        self,
        points: Float[AnyArray, "*batch n 3"] | Lists,
        normals: Float[AnyArray, "*batch n 3"] | Lists,
        friction: Float[AnyArray, "*batch n"] | Lists,
        squeeze: Float[AnyArray, "*batch n"] | Lists,
        present: Float[AnyArray, "*batch n"] | Lists | None = None,
        torsion: Float[AnyArray, "*batch n"] | Lists | None = None,
    ):
        self.points = from_lists("points", points)
        self.normals = from_lists("normals", normals)
        self.friction = from_lists("friction", friction)
        self.squeeze = from_lists("squeeze", squeeze)
        self.present = from_lists("present", present)
        self.torsion = from_lists("torsion", torsion)


NORMALS, TORQUES = ("normal_min", "normal_max"), ("torque_map", "torque_max")
BOUNDS = (*NORMALS, *TORQUES)
"""The fields of Limits."""


class Limits(eqx.Module):
    """Bounds that forces must respect besides friction, for one grasp or a batch; ``None`` where there is none.

    The hand itself does not appear: joints are known by what the contact forces ask of them,
    torque = sum of torque_map_i^T f_i. Building them checks nothing; hand concrete ones
    to [`jaxgrasp.check_limits`][] first.
    """

    normal_min: Float[AnyArray, "*batch n"] | None
    """Least normal force of each contact >= 0 [N]: a preload."""
    normal_max: Float[AnyArray, "*batch n"] | None
    """Largest normal force of each contact [N], no smaller than the least; inf where there is none."""
    torque_map: Float[AnyArray, "*batch n c j"] | None
    """Contact Jacobians [m/rad, or 1 for joints that slide]: velocity of the contact by the speed of each joint, as
    [`jaxgrasp.hand.contact_jacobian`][] gives it; c is 3, or 4 with a last row for the speed of turning about the
    normal, which the moments of soft fingers work on [1]."""
    torque_max: Float[AnyArray, "*batch j"] | None
    """Largest torque of each joint, in either direction, >= 0 [N.m, or N]; inf where there is none."""

    # Rather than converters of the fields, whose shapes would go unchecked.
    def __init__(
        self,
        *,
        normal_min: Float[AnyArray, "*batch n"] | Lists | None = None,
        normal_max: Float[AnyArray, "*batch n"] | Lists | None = None,
        torque_map: Float[AnyArray, "*batch n c j"] | Lists | None = None,
        torque_max: Float[AnyArray, "*batch j"] | Lists | None = None,
    ):
        self.normal_min = from_lists("normal_min", normal_min)
        self.normal_max = from_lists("normal_max", normal_max)
        self.torque_map = from_lists("torque_map", torque_map)
        self.torque_max = from_lists("torque_max", torque_max)
