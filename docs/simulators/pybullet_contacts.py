"""PyBullet: is a box between three spheres held? Contacts of ``getContactPoints``, normals from B towards A."""

import numpy as np
import pybullet as bullet

from jaxgrasp import quality, weight_wrench
from jaxgrasp.interop import from_contact_arrays

bullet.connect(bullet.DIRECT)
bullet.setGravity(0, 0, -9.81)
box = bullet.createMultiBody(0.2, bullet.createCollisionShape(bullet.GEOM_BOX, halfExtents=[0.03] * 3))
ball = bullet.createCollisionShape(bullet.GEOM_SPHERE, radius=0.02)
tips = [bullet.createMultiBody(0, ball, -1, [x, y, 0]) for x, y in ((-0.0495, 0), (0.0495, 0.01), (0.0495, -0.01))]
for body in (box, *tips):
    bullet.changeDynamics(body, -1, lateralFriction=0.9)
for _ in range(10):
    bullet.stepSimulation()

contacts = [c for c in bullet.getContactPoints(bodyA=box) if c[2] in tips]  # c[2] is B: the table would not count
friction = 0.9 * 0.9  # Bullet multiplies the coefficients of both bodies
center = np.array(bullet.getBasePositionAndOrientation(box)[0])
grasp = from_contact_arrays(
    points=np.array([c[5] for c in contacts]),  # positionOnA
    normals=np.array([c[7] for c in contacts]),  # contactNormalOnB, into A
    friction=friction,
    forces=np.array([c[9] for c in contacts]),  # normalForce
    body=np.array([c[2] for c in contacts]),
    center=center,
).grasp
print(quality.hold_margin(grasp, weight_wrench(0.2, np.zeros(3), np.array([0, 0, -9.81]))))
