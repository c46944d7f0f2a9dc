"""A weight rendered by the hand's full pipeline: contacts and depths, eq. 6, method B, and inertia as it is lifted.

The exact law has known contacts on the fingers and shares the weight among them equally. Here a plate on a vertical
rail lies on the fingers, with the depth of each contact. It is laid on the fingers in their posture at the start of a
stimulus.
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
    engaged_share,
)
from jaxgrasp.lab.haptic_loop import Haptics
from jaxgrasp.model.arrays import AnyArray, Float
from jaxgrasp.model.hand import Pose
from jaxgrasp.model.task import GRAVITY
from jaxgrasp.psychophysics.plan import StimulusPlan
from jaxgrasp.validation.checked import checked

THICKNESS = 0.04
"""Thickness of the plate [m]: pads that rise faster than others go deep into it, and must not come out at the top."""
OVERHANG = np.array([0.04, 0.008, 0.0])
"""Overhang of the plate beyond the outermost pads, along the fingers, which draw back as they bend, and across [m]."""
PLATE_DEPTH = 1e-3
"""Depth of the plate on the pad of least contact [m]."""
STIFFNESS = 400.0
"""K of eq. 6 [N/m]."""
POSTURE_INTERVAL = 0.05
"""Time between two postures of the predicted lift [s]: slow enough to exclude inertia."""
G = float(np.linalg.norm(GRAVITY))
DOWN = np.diag([1.0, -1.0, -1.0])


class CarriedPlate(Rendering):
    """Renderer that simulates a plate for each stimulus, from tick to tick."""

    def __init__(self, target: Lifted, model: GloveModel) -> None:
        """Compile all programs, before the glove is armed."""
        self._target = target
        self._scene = _plate_scene(target)
        self._rest_height, self._is_laid, self._intensity = 0.0, False, 1.0
        start = np.asarray(target.start, float)
        fixed_angles = np.asarray(target.glove.posture(start, PALM_UP).angles)
        self._haptics = Haptics(self._scene, model, fixed_angles, self._laid_on(start)[1], "closed-form")
        ticks = [self.tick(POSTURE_INTERVAL * k, angles) for k, angles in enumerate(target.postures())]
        self._unit = np.array([tick.law.torques for tick in ticks if tick.is_alone])
        self.begin(0.0)

    def begin(self, intensity: float) -> None:
        self._intensity, self._is_laid = intensity, False

    def tick(self, timestamp: float, angles: Float[np.ndarray, "channels"]) -> FeltTick:
        if not self._intensity > 0:
            zeros = np.zeros(len(angles))
            return FeltTick(TorqueLaw(timestamp, True, np.asarray(angles, float), zeros, np.diag(zeros)), 0.0, True)
        if not self._is_laid:
            scene, placed = self._laid_on(angles)
            self._haptics.restart(scene, placed)
            self._rest_height, self._is_laid = float(placed.origin[2]), True
        law = self._haptics.tick(timestamp, angles, PALM_UP)
        rise = float(self._haptics.placed.origin[2]) - self._rest_height
        return FeltTick(law, float(engaged_share(rise)), rise <= TRAVEL)

    def predicted_torques(self, intensity: float) -> Float[np.ndarray, "P channels"]:
        # Forces at rest are proportional to the weight: method B shares it by the depths.
        return intensity * self._unit

    def _laid_on(self, angles: Float[np.ndarray, "channels"]) -> tuple[Scene, Pose]:
        """Return the scene with the plate on the fingers in their posture, with its weight, and the pose of the
        plate."""
        bottom = float(_lowest_pad(self._target, angles)) - PLATE_DEPTH
        middle = np.asarray(self._scene.table.origin)[:2]
        table, stop = (np.append(middle, bottom + above) for above in (0.0, THICKNESS + TRAVEL))
        scene = eqx.tree_at(
            lambda s: (s.body.mass, s.table.origin, s.obstacles[0].placed.origin),
            self._scene,
            (jnp.asarray(self._intensity / G), jnp.asarray(table), jnp.asarray(stop)),
        )
        return scene, Pose(jnp.asarray(np.append(middle, bottom + THICKNESS / 2)), jnp.eye(3))


@checked
def rendering_of(plan: StimulusPlan, target: FeltObject, model: GloveModel) -> Rendering:
    """Build the renderer of a plan's stimulus, and compile its programs."""
    if plan.rendering == "simulated":
        assert isinstance(target, Lifted), "a plan allows simulated rendering for weights only"
        return CarriedPlate(target, model)
    return LawOfAngles(target)


@jax.jit
def _lowest_pad(target: Lifted, angles: Float[AnyArray, "channels"]) -> Float[Array, ""]:
    """Return the height of the top of the lowest pad [m]."""
    return jnp.min(target.pads(angles)[1][:, 2])


def _plate_scene(target: Lifted) -> Scene:
    """Build the scene with a plate over the pads and no other finger, at the world's origin, with a weight of 1 N."""
    tops = np.asarray(target.pads(target.start)[1])
    low, high = tops.min(0) - OVERHANG, tops.max(0) + OVERHANG
    shape = Box(high[0] - low[0], high[1] - low[1], THICKNESS)
    middle = jnp.append(jnp.asarray((low + high)[:2] / 2), 0.0)
    # The stop acts on its four upper corners.
    stop = Obstacle(Plane(), Pose(middle, jnp.asarray(DOWN)), STOP / 4, touches_hand=False)
    return Scene(
        hand=target.hand,
        body=Body(shape, jnp.asarray(1 / G)),
        table=Pose(middle, jnp.eye(3)),
        friction=FRICTION,
        stiffness=STIFFNESS,
        contributions=jnp.ones(len(target.hand.links)),
        gravity=jnp.asarray(GRAVITY),
        guide=jnp.eye(6)[:, 2:3],
        obstacles=(stop,),
        outline=rigid_body(sphere_tree(shape, 4)),
    )
