"""Hand among the objects of a world: its forces on the object that it squeezes most, and the poses of all."""

from functools import cache
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxgrasp.grip.monitor import Law
from jaxgrasp.grip.scene_file import GrippedScene
from jaxgrasp.hand.kinematics import pose_hand
from jaxgrasp.lab.haptic_loop import Followed
from jaxgrasp.model.arrays import AnyArray
from jaxgrasp.model.hand import HandFrames, Pose, Posture
from jaxgrasp.numerics.compiled_code import jit_here
from jaxgrasp.report.surfaces import pose_matrix, shape_surface
from jaxgrasp.view.drawing import LawComparison, PosedHand, SolvedGrasp, compare_laws, numbers_as_arrays
from jaxgrasp.view.live_scene import Controls, LiveScene, clip_dt, moving_poses, scene_with
from jaxgrasp.world.hand_share import BodyTouches, HandShare, cut_share, find_touches
from jaxgrasp.world.many_bodies import HandMove, World, WorldState, holding_weights, left_at_rest
from jaxgrasp.world.quasi_static import QuasiStaticEngine


class _SetWorld(NamedTuple):
    """World with the settings of the controls, and the engine that moves it."""

    settings: tuple
    world: World
    """World with all its numbers as arrays."""
    engine: QuasiStaticEngine
    weights: np.ndarray


class LiveWorld(LiveScene):
    """A gripped scene with further objects, which our own engine moves."""

    def __init__(self, gripped: GrippedScene, world: World, state: WorldState, law: Law):
        """Build the scene of a world; ``state`` holds the initial poses of the objects."""
        super().__init__(gripped, law)
        self.world, self._first = world, state
        self._world = numbers_as_arrays(world)
        self.other_surfaces = [shape_surface(body.body.shape) for body in world.others]
        self._configured_world: _SetWorld | None = None
        self._state: WorldState | None = None
        self._previous_posture: Posture | None = None

    @property
    def initial_followed(self) -> Followed:
        contributions = np.asarray(self.world.scene.contributions, float)
        return Followed(self._first.placed, holding_weights(self.world), contributions, self._first.time)

    def look(self, controls: Controls) -> SolvedGrasp:
        configured, posture, state = self._configured(controls), self._posture(controls), self._initial_world(controls)
        frames, touches = _programs().touch(configured.world, posture, state.placed)
        contacts, links = jax.device_get((touches.contacts, frames))
        wrench = left_at_rest(configured.engine, state, contacts, links, configured.weights)
        return self._collect(configured.world, posture, state.placed, wrench, state.time, frames, touches)

    def step(self, controls: Controls, dt: float) -> SolvedGrasp:
        configured, posture = self._configured(controls), self._posture(controls)
        state, previous = self._state, self._previous_posture
        if state is None or previous is None:
            state, previous = self._initial_world(controls), posture
        frames, touches = _programs().touch(configured.world, previous, state.placed)
        contacts, frames_before, next_frames = jax.device_get(
            (touches.contacts, frames, pose_hand(self.gripped.scene.hand, posture))
        )
        step = configured.engine.step(state, HandMove(contacts, frames_before, next_frames), clip_dt(dt))
        self._state, self._previous_posture = step.state, posture
        wrench = step.left_to_hand(configured.weights)
        return self._collect(configured.world, previous, state.placed, wrench, state.time, frames, touches)

    def reset(self) -> None:
        self._state = self._previous_posture = None

    def follow(self, posture: Posture, followed: Followed) -> SolvedGrasp:
        inputs = (posture, followed.placed, followed.wrenches)
        posture, placed, wrench = jax.tree.map(lambda leaf: jnp.asarray(leaf, float), inputs)
        frames, touches = _programs().touch(self._world, posture, placed)
        return self._collect(self._world, posture, placed, wrench, followed.time, frames, touches)

    def _initial_world(self, controls: Controls) -> WorldState:
        """Return the initial state of all objects, with the gripped object at the pose of the controls."""
        placed, gripped_pose = self._first.placed, self._placed(controls)
        origin = np.concatenate([np.asarray(gripped_pose.origin, float)[None], placed.origin[1:]])
        return self._first._replace(placed=Pose(origin, placed.rotation))

    def _configured(self, controls: Controls) -> _SetWorld:
        """Return the world with the settings of the controls; it is rebuilt when they change."""
        settings = (controls.friction, controls.squeeze, controls.mass, *controls.gravity.tolist())
        if self._configured_world is None or self._configured_world.settings != settings:
            scene = scene_with(self._world.scene, controls)
            other_bodies = [
                eqx.tree_at(lambda body: body.stiffness, body, body.stiffness * controls.squeeze)
                for body in self._world.others
            ]
            world = World(scene, tuple(other_bodies))
            engine = QuasiStaticEngine(jax.device_get(world), self._first)
            self._configured_world = _SetWorld(settings, world, engine, holding_weights(world))
        return self._configured_world

    def _collect(
        self,
        world: World,
        posture: Posture,
        placed: Pose,
        wrench: AnyArray,
        time: float,
        frames: HandFrames,
        touches: BodyTouches,
    ) -> SolvedGrasp:
        """Collect contacts and forces on the object that the hand squeezes most, and the torques of all contacts."""
        shared = _programs().share(world, posture, placed, touches, jnp.asarray(wrench), time, law=self.law)
        links, share, comparison = jax.device_get((frames.links, *shared))
        squeeze_sums = np.sum(share.touches.grasp.squeeze * (share.touches.grasp.present > 0.5), -1)
        most_squeezed = int(np.argmax(squeeze_sums))
        grasp, assessment, margins, closed_touches = jax.tree.map(
            lambda part: part[most_squeezed],
            (share.touches.grasp, share.assessment, comparison.margins, comparison.closed_touches),
        )
        objects = pose_matrix(placed)
        return SolvedGrasp(
            grasp=grasp,
            origin=objects[most_squeezed, :, 3],
            wrench=share.wrench[most_squeezed],
            assessment=assessment,
            margins=margins,
            closed_touches=closed_touches,
            law=self.law,
            names=self._names,
            object_pose=objects[0],
            hand=PosedHand(pose_matrix(links), self.gripped.scene.hand.joints, share.torques),
            moving=np.concatenate([objects[1:], moving_poses(self.world.scene, time)]),
        )


class _Programs(NamedTuple):
    touch: Any
    share: Any


@cache
def _programs() -> _Programs:
    """Return the programs of contacts and of forces, compiled for a short compile time: a person waits."""
    return _Programs(jit_here(_touch), jit_here(_share, static_argnames="law"))


def _touch(world: World, posture: Posture, placed: Pose) -> tuple[HandFrames, BodyTouches]:
    return pose_hand(world.scene.hand, posture), find_touches(world, posture, placed)


def _share(
    world: World, posture: Posture, placed: Pose, touches: BodyTouches, wrench: AnyArray, time: AnyArray, *, law: Law
) -> tuple[HandShare, LawComparison]:
    share = cut_share(world.at_time(time), posture, placed, touches, wrench, law=law)
    return share, compare_laws(share.touches.grasp, share.assessment)
