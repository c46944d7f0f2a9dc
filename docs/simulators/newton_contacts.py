"""Newton: which of its worlds holds a box between three spheres? Arrays of Warp, read where they are."""

import jax.numpy as jnp
import newton
import warp as wp

from jaxgrasp import quality, weight_wrench
from jaxgrasp.interop import from_contact_arrays

world = newton.ModelBuilder()
body = world.add_body(mass=0.2)
world.add_shape_box(body, hx=0.03, hy=0.03, hz=0.03)
for x, y in ((-0.0495, 0.0), (0.0495, 0.01), (0.0495, -0.01)):
    world.add_shape_sphere(-1, xform=wp.transform(wp.vec3(x, y, 0.0), wp.quat_identity()), radius=0.02)
(builder := newton.ModelBuilder()).replicate(world, 2)
model = builder.finalize(device="cpu")
state = model.state()
moved = state.body_q.numpy()
moved[1, 0] = 0.5  # the box of the second world lies elsewhere
state.body_q.assign(moved)
contacts = model.contacts()
model.collide(state, contacts)

shapes = [jnp.from_dlpack(a) for a in (contacts.rigid_contact_shape0, contacts.rigid_contact_shape1)]
bodies = jnp.from_dlpack(model.shape_body)[jnp.stack(shapes)]  # -1: the spheres
is_first = bodies[0] >= 0
local = map(jnp.from_dlpack, (contacts.rigid_contact_point0, contacts.rigid_contact_point1))
points = jnp.where(is_first[:, None], *local)  # in the box's frame, whose axes are the world's here
normals = jnp.where(is_first[:, None], -1, 1) * jnp.from_dlpack(contacts.rigid_contact_normal)  # from 0 to 1
listed = jnp.arange(len(points)) < jnp.from_dlpack(contacts.rigid_contact_count)[0]
grasp = from_contact_arrays(
    points, normals, 0.9, squeeze=4.0, world=jnp.where(listed, bodies.max(0), -1), n_worlds=2, max_contacts=4
).grasp
print(*quality.hold_margin(grasp, weight_wrench(0.2, jnp.zeros(3), jnp.array([0, 0, -9.81]))))
