"""Closing a hand on an object: every finger flexes until it presses."""

from functools import partial
from itertools import combinations

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from jaxgrasp.hand.detection import Contacts, find_contacts
from jaxgrasp.hand.kinematics import ancestry, pose_hand
from jaxgrasp.hand.shapes import Shape
from jaxgrasp.model.arrays import AnyArray, Float
from jaxgrasp.model.hand import Hand, Pose, Posture
from jaxgrasp.validation.checked import checked


@checked
@partial(jax.jit, static_argnames=("fingers_apart", "steps"))
def close_hand(
    hand: Hand,
    posture: Posture,
    shape: Shape,
    placed: Pose,
    depth: float | AnyArray = 1e-3,
    *,
    towards: Float[AnyArray, "*#batch J"] | None = None,
    fingers_apart: bool = False,
    steps: int = 200,
) -> tuple[Posture, Contacts]:
    """Turn the joints until the links press into the object.

    All joints turn together, each by its share of the way. A joint stops where a link that it carries has reached
    the depth, or at its limit; those beyond it go on, so that a finger wraps around what it meets. Joints that are
    coupled (``Hand.coupling``) go and stop together, from where the law has those that follow others. A hand that
    starts inside the object stays there: [`jaxgrasp.hand.check_clear`][] finds out.

    Args:
        hand: one for all postures.
        posture: where it starts; any leading axes.
        shape: what it closes on.
        placed: where that stands, and stays.
        depth: of penetration at which a link has pressed enough [m].
        towards: angles at the end of an unhindered way [rad]; the flexions' upper limits where not given, the
            other joints as they are.
        fingers_apart: whether fingers also stop where they meet one another, to within a step; else they pass through.
            It looks at every pair of spheres, which takes longer than all else.
        steps: of equal size to go there in.

    Returns:
        The closed posture, and its contacts.
    """
    start = jnp.asarray(posture.angles)
    towards = flexed(hand, start) if towards is None else jnp.asarray(towards)
    moves, coupling = jnp.asarray(ancestry(hand)), hand.coupling
    if coupling is None:
        stride = (towards - start) / steps
    else:
        # Independent joints stop, for a link that any of their followers carries, and take these with them.
        start, moves = coupling.angles(start), moves @ (jnp.asarray(coupling.matrix) != 0).astype(float) > 0
        stride = (towards - start)[..., list(coupling.independent)] / steps

    def contacts_at(angles: Array) -> Contacts:
        return find_contacts(hand, Posture(posture.wrist, angles), shape, placed)

    pairs = phalanx_pairs(hand) if fingers_apart else np.zeros((0, 2), int)
    pair_moves = moves[pairs].any(1)
    initial_overlaps = link_overlaps(hand, Posture(posture.wrist, start), pairs)

    def advance(carry: tuple[Array, Array], _: None) -> tuple[tuple[Array, Array], None]:
        angles, free = carry
        # A link that presses enough already stops its joints before they move.
        pressed = contacts_at(angles).depths >= depth
        free = free & ~jnp.any(moves & pressed[..., None], -2)
        if len(pairs):
            collides = link_overlaps(hand, Posture(posture.wrist, angles), pairs) > jnp.maximum(initial_overlaps, 0)
            free = free & ~jnp.any(pair_moves & collides[..., None], -2)
        step = jnp.where(free, stride, 0)
        return (angles + (step if coupling is None else step @ jnp.asarray(coupling.matrix).T), free), None

    (angles, _), _ = lax.scan(advance, (start, jnp.ones(stride.shape, bool)), length=steps)
    return Posture(posture.wrist, angles), contacts_at(angles)


def flexed(hand: Hand, angles: Float[AnyArray, "*batch J"]) -> Float[Array, "*batch J"]:
    """Return the angles [rad] with all flexions at their upper limits and the other joints unchanged."""
    flexes = np.array(["abduction" not in name for name in hand.joints])
    return jnp.where(flexes, hand.upper, angles)


def phalanx_pairs(hand: Hand) -> np.ndarray:
    """Return the pairs ``(P, 2)`` of links of different fingers, which may meet."""
    phalanges = [k for k, link in enumerate(hand.links) if link.phalanx and link.joint >= 0]
    pairs = [(i, j) for i, j in combinations(phalanges, 2) if hand.links[i].finger != hand.links[j].finger]
    return np.array(pairs, int).reshape(-1, 2)


def link_overlaps(hand: Hand, posture: Posture, pairs: np.ndarray) -> Array:
    """Compute the overlap ``(..., P)`` of the two links of each pair; negative where they are apart [m]."""
    links = pose_hand(hand, posture).links
    centers = jnp.einsum("...lij,lmj->...lmi", links.rotation, hand.skin.centers) + links.origin[..., None, :]
    return sphere_overlaps(centers, hand.skin.radii, pairs)


def sphere_overlaps(centers: AnyArray, radii: AnyArray, pairs: np.ndarray) -> Array:
    """Compute the overlap ``(..., P)`` of pairs of rows of spheres ``(..., L, m, 3)``; negative where apart [m]."""
    centers, radii = jnp.asarray(centers), jnp.asarray(radii)
    first, second = pairs.T
    offset = centers[..., first, :, None, :] - centers[..., second, None, :, :]
    is_sphere = (radii[first, :, None] > 0) & (radii[second, None, :] > 0)
    # r_i + r_j - |c_i - c_j|
    overlap = radii[first, :, None] + radii[second, None, :] - jnp.sqrt(jnp.sum(offset**2, -1))
    return jnp.max(jnp.where(is_sphere, overlap, -jnp.inf), (-2, -1))
