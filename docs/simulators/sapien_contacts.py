"""SAPIEN, below ManiSkill: is a box between three spheres held? Contacts of ``get_contacts``, impulses of a step."""

import numpy as np
import sapien

from jaxgrasp import quality, weight_wrench
from jaxgrasp.interop import from_contact_arrays

scene = sapien.Scene([sapien.physx.PhysxCpuSystem()])
scene.set_timestep(1 / 240)
rubber = scene.create_physical_material(0.9, 0.9, 0.0)
builder = scene.create_actor_builder()
builder.add_box_collision(half_size=[0.03] * 3, material=rubber, density=926)
box = builder.build("box")
for i, place in enumerate([[-0.0495, 0, 0], [0.0495, 0.01, 0], [0.0495, -0.01, 0]]):
    builder = scene.create_actor_builder()
    builder.add_sphere_collision(radius=0.02, material=rubber)
    builder.build_kinematic(f"tip {i}").set_pose(sapien.Pose(place))
for _ in range(5):
    scene.step()

pairs = [c for c in scene.get_contacts() if box in [body.entity for body in c.bodies]]
rows = [(point, 1.0 if c.bodies[0].entity is box else -1.0) for c in pairs for point in c.points]
contacts = from_contact_arrays(
    points=np.array([point.position for point, _ in rows]),
    normals=np.array([sign * point.normal for point, sign in rows]),
    friction=0.9,
    forces=np.array([sign * point.impulse for point, sign in rows]) * 240,  # on the first body, in one step
    direction="by_force",
    center=box.get_pose().p,
)
print(quality.hold_margin(contacts.grasp, weight_wrench(0.2, np.zeros(3), np.array([0, 0, -9.81]))))
