"""A hand among the objects of a world, seen: what it exerts on the one that it squeezes most, and where all are."""

from functools import cache, partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxgrasp.grip.monitor import Law
from jaxgrasp.grip.scene_file import GrippedScene
from jaxgrasp.hand.kinematics import pose_hand
from jaxgrasp.lab.haptic_loop import Followed
from jaxgrasp.model.arrays import AnyArray
from jaxgrasp.model.hand import HandFrames, Pose, Posture
from jaxgrasp.numerics.compiled_code import compile_options
from jaxgrasp.report.surfaces import DrawnSurface, pose_matrix, shape_surface
from jaxgrasp.view.seen import Judged, PosedHand, Seen, judged_by_both, numbers_as_arrays
from jaxgrasp.view.standing_surfaces import moving_poses
from jaxgrasp.world.hand_share import HandShare, cut_share, touched_things
from jaxgrasp.world.many_bodies import World, WorldState, holding_weights


class LiveWorld:
    """A gripped scene with further objects, as a haptic loop has them."""

    def __init__(self, made: GrippedScene, world: World, state: WorldState, law: Law):
        """``state``: where the objects are at first."""
        self.made, self.law, self.world = made, law, world
        self._names = [link.name for link in made.scene.hand.links]
        self._world = numbers_as_arrays(world)
        contributions = np.asarray(world.scene.contributions, float)
        self.begun = Followed(state.placed, holding_weights(world), contributions, state.time)
        self.others: list[DrawnSurface] = [shape_surface(thing.body.shape) for thing in world.others]

    def follow(self, posture: Posture, followed: Followed) -> Seen:
        """A hand that others move, and objects that go with it.

        Contacts and forces are those with the object that it squeezes most; torques are those of all.
        """
        given = (posture, followed.placed, followed.wrenches, followed.time)
        given = jax.tree.map(lambda leaf: jnp.asarray(leaf, float), given)
        frames, share, judged = jax.device_get(_look()(self._world, *given, law=self.law))
        pressed = np.sum(share.touches.grasp.squeeze * (share.touches.grasp.present > 0.5), -1)
        most = int(np.argmax(pressed))
        grasp, assessment, margins, touches = jax.tree.map(
            lambda part: part[most], (share.touches.grasp, share.assessment, judged.margins, judged.closed_touches)
        )
        objects = pose_matrix(followed.placed)
        return Seen(
            grasp=grasp,
            origin=objects[most, :, 3],
            wrench=share.wrench[most],
            assessment=assessment,
            margins=margins,
            closed_touches=touches,
            law=self.law,
            names=self._names,
            object_pose=objects[0],
            hand=PosedHand(pose_matrix(frames.links), self.made.scene.hand.joints, share.torques),
            moving=np.concatenate([objects[1:], moving_poses(self.world.scene, followed.time)]),
        )


@cache
def _look() -> Any:
    """What is seen, compiled in less time than otherwise: a person waits for it."""
    return partial(jax.jit, static_argnames="law", compiler_options=compile_options())(_looked)


def _looked(
    world: World, posture: Posture, placed: Pose, wrench: AnyArray, time: AnyArray, *, law: Law
) -> tuple[HandFrames, HandShare, Judged]:
    world = world.at_time(time)
    share = cut_share(world, posture, placed, touched_things(world, posture, placed), wrench, law=law)
    judged = judged_by_both(share.touches.grasp, share.assessment)
    return pose_hand(world.scene.hand, posture), share, judged
