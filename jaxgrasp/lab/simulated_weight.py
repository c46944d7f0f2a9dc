"""A weight by the hand's whole pipeline: contacts and depths, eq. 6, method B, and inertia as it is lifted.

The exact law knows where fingers bear and shares the weight among them alike. Here a plate lies on them, as deep as
each has it, on a rail that is vertical. It is laid on the fingers as they are when a stimulus begins.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxgrasp.glove.loop.exchange import TorqueLaw
from jaxgrasp.glove.model import GloveModel
from jaxgrasp.grip.motion import Body
from jaxgrasp.grip.scene import Obstacle, Scene
from jaxgrasp.hand.filling import sphere_tree
from jaxgrasp.hand.shapes import Box, Plane
from jaxgrasp.hand.world import rigid_body
from jaxgrasp.lab.felt_objects import (
    FRICTION,
    PALM_UP,
    STOP,
    TRAVEL,
    FeltObject,
    FeltTick,
    LawOfAngles,
    Lifted,
    Rendering,
    passed_over,
)
from jaxgrasp.lab.haptic_loop import Haptics
from jaxgrasp.model.arrays import AnyArray, Float
from jaxgrasp.model.hand import Pose
from jaxgrasp.model.task import GRAVITY
from jaxgrasp.psychophysics.plan import StimulusPlan
from jaxgrasp.validation.checked import checked

THICK = 0.04
"""Thickness of the plate [m]: pads that rise faster than the others go deep into it, and must not come out above."""
OVER = np.array([0.04, 0.008, 0.0])
"""How far it reaches beyond the outermost pads, along the fingers, which draw back as they bend, and across [m]."""
SUNK = 1e-3
"""Depth at which it lies on the pad that has it least [m]."""
STIFFNESS = 400.0
"""K of eq. 6 [N/m]."""
SLOWLY = 0.05
"""Time between two postures of the way up that is predicted [s]: nothing of it is inertia."""
G = float(np.linalg.norm(GRAVITY))
DOWN = np.diag([1.0, -1.0, -1.0])


class CarriedPlate(Rendering):
    """The plate of one stimulus after another, followed from tick to tick."""

    def __init__(self, felt: Lifted, model: GloveModel) -> None:
        """Compiled here, before anything is armed."""
        self._felt = felt
        self._scene = _plate_scene(felt)
        self._rest, self._is_laid, self._intensity = 0.0, False, 1.0
        start = np.asarray(felt.start, float)
        others = np.asarray(felt.worn.posture(start, PALM_UP).angles)
        self._haptics = Haptics(self._scene, model, others, self._laid_on(start)[1], "closed-form")
        ticks = [self.tick(SLOWLY * k, angles) for k, angles in enumerate(felt.postures())]
        self._unit = np.array([tick.law.torques for tick in ticks if tick.is_alone])
        self.begin(0.0)

    def begin(self, intensity: float) -> None:
        self._intensity, self._is_laid = intensity, False

    def tick(self, now: float, angles: Float[np.ndarray, "channels"]) -> FeltTick:
        if not self._intensity > 0:
            none = np.zeros(len(angles))
            return FeltTick(TorqueLaw(now, True, np.asarray(angles, float), none, np.diag(none)), 0.0, True)
        if not self._is_laid:
            scene, placed = self._laid_on(angles)
            self._haptics.restart(scene, placed)
            self._rest, self._is_laid = float(placed.origin[2]), True
        law = self._haptics.tick(now, angles, PALM_UP)
        rise = float(self._haptics.placed.origin[2]) - self._rest
        return FeltTick(law, float(passed_over(rise)), rise <= TRAVEL)

    def on_the_way(self, intensity: float) -> Float[np.ndarray, "P channels"]:
        # Forces that hold a weight at rest are in proportion to it: method B shares it by the depths.
        return intensity * self._unit

    def _laid_on(self, angles: Float[np.ndarray, "channels"]) -> tuple[Scene, Pose]:
        """The scene of the plate on the fingers as they are, of its weight, and where the plate is."""
        bottom = float(_lowest_pad(self._felt, angles)) - SUNK
        middle = np.asarray(self._scene.table.origin)[:2]
        table, stop = (np.append(middle, bottom + above) for above in (0.0, THICK + TRAVEL))
        scene = eqx.tree_at(
            lambda s: (s.body.mass, s.table.origin, s.obstacles[0].placed.origin),
            self._scene,
            (jnp.asarray(self._intensity / G), jnp.asarray(table), jnp.asarray(stop)),
        )
        return scene, Pose(jnp.asarray(np.append(middle, bottom + THICK / 2)), jnp.eye(3))


@checked
def rendering_of(plan: StimulusPlan, felt: FeltObject, model: GloveModel) -> Rendering:
    """How a plan's stimulus is rendered; compiles what it needs."""
    if plan.rendering == "simulated":
        assert isinstance(felt, Lifted), "the plan allows it of a weight alone"
        return CarriedPlate(felt, model)
    return LawOfAngles(felt)


@jax.jit
def _lowest_pad(felt: Lifted, angles: Float[AnyArray, "channels"]) -> Float[Array, ""]:
    """Height of that pad's top which is lowest [m]."""
    return jnp.min(felt.pads(angles)[1][:, 2])


def _plate_scene(felt: Lifted) -> Scene:
    """A plate that reaches over the pads and no other finger, at the world's origin, its weight 1 N."""
    tops = np.asarray(felt.pads(felt.start)[1])
    low, high = tops.min(0) - OVER, tops.max(0) + OVER
    shape = Box(high[0] - low[0], high[1] - low[1], THICK)
    middle = jnp.append(jnp.asarray((low + high)[:2] / 2), 0.0)
    # Its four upper corners meet the stop.
    stop = Obstacle(Plane(), Pose(middle, jnp.asarray(DOWN)), STOP / 4, touches_hand=False)
    return Scene(
        hand=felt.hand,
        body=Body(shape, jnp.asarray(1 / G)),
        table=Pose(middle, jnp.eye(3)),
        friction=FRICTION,
        stiffness=STIFFNESS,
        contributions=jnp.ones(len(felt.hand.links)),
        gravity=jnp.asarray(GRAVITY),
        guide=jnp.eye(6)[:, 2:3],
        obstacles=(stop,),
        outline=rigid_body(sphere_tree(shape, 4)),
    )
