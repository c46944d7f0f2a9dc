"""Drake: is a box between three spheres held? Point contacts of ``ContactResults``; hydroelastic ones are surfaces."""

import numpy as np
import pydrake.all as drake

from jaxgrasp import quality, weight_wrench
from jaxgrasp.interop import from_contact_arrays

builder = drake.DiagramBuilder()
plant, _ = drake.AddMultibodyPlantSceneGraph(builder, 1e-3)
box = plant.AddRigidBody("box", drake.SpatialInertia.SolidBoxWithMass(0.2, 0.06, 0.06, 0.06))
rubber = drake.CoulombFriction(0.9, 0.9)
plant.RegisterCollisionGeometry(box, drake.RigidTransform(), drake.Box(0.06, 0.06, 0.06), "box", rubber)
for i, place in enumerate([[-0.0498, 0, 0], [0.0498, 0.01, 0], [0.0498, -0.01, 0]]):
    frame = drake.RigidTransform(place)
    plant.RegisterCollisionGeometry(plant.world_body(), frame, drake.Sphere(0.02), f"tip {i}", rubber)
plant.Finalize()
simulator = drake.Simulator(builder.Build())
simulator.AdvanceTo(0.01)

context = plant.GetMyContextFromRoot(simulator.get_context())
results = plant.get_contact_results_output_port().Eval(context)
pairs = [results.point_pair_contact_info(i) for i in range(results.num_point_pair_contacts())]
sign = np.array([1.0 if pair.bodyA_index() == box.index() else -1.0 for pair in pairs])[:, None]
contacts = from_contact_arrays(
    points=np.array([pair.contact_point() for pair in pairs]),
    normals=sign * np.array([pair.point_pair().nhat_BA_W for pair in pairs]),  # from B into A
    friction=0.9,  # of equal coefficients; else 2 m n / (m + n)
    forces=-sign * np.array([pair.contact_force() for pair in pairs]),  # on B
    center=plant.EvalBodyPoseInWorld(context, box).translation(),
)
print(quality.hold_margin(contacts.grasp, weight_wrench(0.2, np.zeros(3), np.array([0, 0, -9.81]))))
