"""MuJoCo's engine for a world (extra ``hands``): objects, table, obstacles and guide as its bodies, a kinematic hand.

- The skin's balls are those of contact detection. Each ball forms a MuJoCo pair with each object, whose stiffness is
  set at every step so that a link presses by K c depth (eq. 6), however many of its balls touch. Soft fingers give each
  ball torsional friction, by MuJoCo's contacts of four dimensions.
- A link is a body too heavy to be pushed aside, whose motion is prescribed: MuJoCo's mocap bodies have no velocity, so
  that they could not drag an object along.
- Obstacles are springs without the friction and the damping that a [`jaxgrasp.grip.Obstacle`][] can have; those with a
  path are moved along it as links are. Contacts among objects and with the table are nearly rigid.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.spatial.transform import Rotation

from jaxgrasp.grip.scene import obstacles_at_time
from jaxgrasp.interop.mujoco_contacts import import_mujoco
from jaxgrasp.model.arrays import AnyArray
from jaxgrasp.model.hand import Pose
from jaxgrasp.world.many_bodies import (
    HAND,
    HandMove,
    Loads,
    Motions,
    Step,
    World,
    WorldState,
    integrate_poses,
    link_motion,
    masses,
    summed_loads,
)
from jaxgrasp.world.mujoco_model import spring_solref, world_model

SUBSTEP = 1e-3
"""Longest step of MuJoCo's [s]."""
MIN_SHARE = 1e-3
"""Least part of K of each ball of a link, for contacts that begin within a step."""


class MujocoEngine:
    """Engine that integrates a world with MuJoCo; MuJoCo warm-starts each step from the last."""

    def __init__(self, world: World, state: WorldState):
        """Build the model.

        Args:
            world: world to move.
            state: state of its objects at the start: the joints of a guided object are placed at that pose.

        Raises:
            ImportError: if MuJoCo is not installed.
            ValueError: for a guide of more than one twist, and shapes that MuJoCo does not support.
        """
        self._mujoco = import_mujoco("MujocoEngine")
        self._weights = masses(world.bodies)
        self._initial = state.placed
        self._parts = parts = world_model(self._mujoco, world, self._weights, state.placed)
        self.model, self.data = parts.model, self._mujoco.MjData(parts.model)
        pressing = np.asarray(world.scene.contributions, float)[:, None] * [float(t.stiffness) for t in world.bodies]
        self._stiffness = np.where(parts.pair_links >= 0, pressing[parts.pair_links, parts.pair_bodies], 0)
        self._of_hand = np.flatnonzero(parts.pair_links >= 0)
        self._free = [n for n in range(len(parts.bodies)) if n > 0 or parts.guide is None]
        joints = [int(self.model.body_jntadr[parts.bodies[n]]) for n in self._free]
        self._pose_index, self._velocity_index = self._addresses(joints)
        self._scene = world.scene
        self._moving = [k for k, obstacle in enumerate(world.scene.obstacles) if obstacle.path is not None]
        prescribed = [f"link {k}" for k in range(len(world.scene.hand.links))] + [f"obstacle {k}" for k in self._moving]
        self._kinematic_pose_index, self._kinematic_velocity_index = self._addresses(
            [int(self.model.body_jntadr[self.model.body(name).id]) for name in prescribed]
        )

    def _addresses(self, joints: list[int]) -> tuple[np.ndarray, np.ndarray]:
        """Return the indices of free joints: ``(n, 7)`` in qpos, ``(n, 6)`` in qvel."""
        pose_index, velocity_index = (
            np.array(adr[joints], int) for adr in (self.model.jnt_qposadr, self.model.jnt_dofadr)
        )
        return pose_index[:, None] + np.arange(7), velocity_index[:, None] + np.arange(6)

    def step(self, state: WorldState, hand: HandMove, dt: float) -> Step:
        """Move the world by one step, in as many of MuJoCo's as needed; see [`jaxgrasp.world.Engine`][]."""
        mujoco, model, data = self._mujoco, self.model, self.data
        count = math.ceil(dt / SUBSTEP - 1e-9)
        model.opt.timestep = dt / count
        links, motion = link_motion(hand.current, hand.later, dt)
        self._write_state(state)
        loads, solved = [], True
        for k in range(count):
            elapsed_s = k * model.opt.timestep
            self._write_kinematic(integrate_poses(links, motion, elapsed_s), motion, state.time + elapsed_s)
            if k == 0:
                self._set_stiffness()
            mujoco.mj_step(model, data)
            loads.append(self._sum_loads())
            solved = solved and max(data.solver_niter) < model.opt.iterations
        after = self._read_state()._replace(time=state.time + dt)
        gained = (self._weights.momentum(after) - self._weights.momentum(state)) / dt
        return Step(after, Loads(*(np.mean(parts, 0) for parts in zip(*loads, strict=True))), gained, solved)

    def _write_state(self, state: WorldState) -> None:
        """Write poses and velocities of the objects into MuJoCo's data."""
        data, placed, motion = self.data, state.placed, state.motion
        free = Pose(placed.origin[self._free], placed.rotation[self._free])
        self._set(
            self._pose_index, self._velocity_index, free, Motions(motion.linear[self._free], motion.angular[self._free])
        )
        guide = self._parts.guide
        if guide is None:
            return
        shift = placed.origin[0] - self._initial.origin[0]
        turn = Rotation.from_matrix(placed.rotation[0] @ self._initial.rotation[0].T)
        if guide.slides:
            data.joint("slide").qpos[0] = guide.axis @ shift
            data.joint("slide").qvel[0] = guide.axis @ motion.linear[0]
        if guide.turns:
            angle = guide.axis @ turn.as_rotvec()
            data.joint("hinge").qpos[0] = guide.axis @ shift / guide.pitch if guide.slides else angle
            data.joint("hinge").qvel[0] = guide.axis @ motion.angular[0]

    def _write_kinematic(self, links: Pose, motion: Motions, time: float) -> None:
        """Write poses and velocities of the links and of moving obstacles into MuJoCo's data."""
        obstacles = obstacles_at_time(self._scene, time) if self._moving else ()
        parts: list[tuple[AnyArray, ...]] = [(links.origin, links.rotation, *motion)]
        for obstacle in (obstacles[k] for k in self._moving):
            assert obstacle.motion is not None, "an obstacle with a path has a motion"
            pose_and_motion = (obstacle.placed.origin, obstacle.placed.rotation, *obstacle.motion)
            parts.append(tuple(np.asarray(part)[None] for part in pose_and_motion))
        origin, rotation, linear, angular = (np.concatenate(column) for column in zip(*parts, strict=True))
        self._set(
            self._kinematic_pose_index, self._kinematic_velocity_index, Pose(origin, rotation), Motions(linear, angular)
        )

    def _set(self, pose_index: np.ndarray, velocity_index: np.ndarray, placed: Pose, motion: Motions) -> None:
        """Write poses and velocities of free joints, whose angular velocities are in the bodies' own frames."""
        quaternions = Rotation.from_matrix(placed.rotation).as_quat()[:, [3, 0, 1, 2]]
        self.data.qpos[pose_index] = np.concatenate([placed.origin, quaternions], 1)
        spins = np.einsum("nji,nj->ni", placed.rotation, motion.angular)
        self.data.qvel[velocity_index] = np.concatenate([motion.linear, spins], 1)

    def _set_stiffness(self) -> None:
        """Set the stiffness of the hand's contacts, so that all balls of a link together press by K c times its depth.

        A link is as deep as its deepest ball (see [`jaxgrasp.hand.find_contacts`][]).
        """
        mujoco, model, data, parts = self._mujoco, self.model, self.data, self._parts
        if not len(self._of_hand):
            return
        mujoco.mj_kinematics(model, data)
        mujoco.mj_collision(model, data)
        depths = np.maximum(-data.contact.dist, 0)
        owners, of_links = parts.owners[data.contact.geom], parts.links[data.contact.geom]
        by_hand = (owners == HAND).any(1)
        link, body = of_links.max(1)[by_hand], owners.max(1)[by_hand]
        total, deepest = np.zeros((2, parts.links.max() + 1, len(parts.bodies)))
        np.add.at(total, (link, body), depths[by_hand])
        np.maximum.at(deepest, (link, body), depths[by_hand])
        # Each ball presses by k d_i, so that sum_i k d_i = K c max_i d_i
        share = np.where(total > 0, deepest / np.where(total > 0, total, 1), 1)
        pairs = self._of_hand
        stiffness = self._stiffness[pairs] * np.maximum(
            share[parts.pair_links[pairs], parts.pair_bodies[pairs]], MIN_SHARE
        )
        model.pair_solref[pairs] = spring_solref(stiffness, self._weights.mass[parts.pair_bodies[pairs]])

    def _sum_loads(self) -> Loads:
        """Sum the contact forces of the last substep into loads."""
        data, parts = self.data, self._parts
        contact = data.contact
        acts = np.flatnonzero(contact.efc_address >= 0)
        first, frames = contact.efc_address[acts], contact.frame[acts].reshape(-1, 3, 3)
        dim = contact.dim[acts]
        along = np.stack([np.where(dim > i, data.efc_force[first + np.minimum(i, dim - 1)], 0) for i in range(4)], 1)
        # MuJoCo's forces act from a contact's first geom on its second; here the first body is the one acted on.
        forces, couples = np.einsum("ci,cij->cj", along[:, :3], frames), along[:, 3:] * frames[:, 0]
        owners = parts.owners[contact.geom[acts]][:, ::-1]
        is_reversed = owners[:, 0] < 0
        for part in (forces, couples):
            part[is_reversed] *= -1
        owners[is_reversed] = owners[is_reversed, ::-1]
        return summed_loads(owners, contact.pos[acts], forces, data.xipos[parts.bodies], couples)

    def _read_state(self) -> WorldState:
        """Read poses and velocities of the objects from MuJoCo's data."""
        mujoco, model, data, parts = self._mujoco, self.model, self.data, self._parts
        mujoco.mj_kinematics(model, data)
        origin, rotation = data.xpos[parts.bodies].copy(), data.xmat[parts.bodies].reshape(-1, 3, 3).copy()
        linear, angular = np.zeros((2, len(parts.bodies), 3))
        rates = data.qvel[self._velocity_index]
        linear[self._free] = rates[:, :3]
        angular[self._free] = np.einsum("nij,nj->ni", rotation[self._free], rates[:, 3:])
        guide = parts.guide
        if guide is not None:
            if guide.turns:
                angular[0] = data.joint("hinge").qvel[0] * guide.axis
                linear[0] = np.cross(angular[0], origin[0] - guide.point)
            if guide.slides:
                linear[0] += data.joint("slide").qvel[0] * guide.axis
        return WorldState(Pose(origin, rotation), Motions(linear, angular))
