"""Genesis: which of its environments holds a box between three spheres? Tensors of ``get_contacts``, padded."""

import genesis as gs
import jax.numpy as jnp
import torch

from jaxgrasp import quality, weight_wrench
from jaxgrasp.interop import from_contact_arrays

gs.init(backend=gs.cpu, logging_level="warning")
scene = gs.Scene(show_viewer=False)
rubber = gs.materials.Rigid(friction=0.9, rho=926)
box = scene.add_entity(gs.morphs.Box(size=(0.06, 0.06, 0.06)), material=rubber)
for x, y in ((-0.0495, 0.0), (0.0495, 0.01), (0.0495, -0.01)):
    scene.add_entity(gs.morphs.Sphere(radius=0.02, pos=(x, y, 0.0), fixed=True), material=rubber)
scene.build(n_envs=2)
box.set_pos(torch.tensor([[0.0, 0, 0], [0.5, 0, 0]]))  # the box of the second environment lies elsewhere
scene.step()

read = box.get_contacts()
is_a = (read["link_a"] == box.base_link_idx)[..., None]
contacts = from_contact_arrays(
    points=read["position"],
    normals=read["normal"],
    friction=0.9,  # the larger one of both bodies
    forces=torch.where(is_a, read["force_a"], read["force_b"]),  # on the box
    direction="by_force",
    present=read["valid_mask"],
    center=box.get_pos(),
)
print(*quality.hold_margin(contacts.grasp, weight_wrench(0.2, jnp.zeros(3), jnp.array([0, 0, -9.81]))))
