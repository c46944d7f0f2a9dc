"""Gripper of two parallel jaws as a Hand, for data sets of grasp poses."""

import jax.numpy as jnp
import numpy as np

from jaxgrasp.model.hand import Hand, Link, Spheres
from jaxgrasp.validation.checked import checked

COLUMNS = 6
"""Spheres across a pad; along it as many to the same length."""
QUARTERS = ((0, 0), (0, 1), (1, 0), (1, 1))
"""Parts of a pad, across and along: single points of contact could not keep an object from turning about the line
between them, as two flat pads do."""


@checked
def parallel_jaw(
    opening: float = 0.08, *, reach: tuple[float, float] = (0.0941, 0.1122), width: float = 0.02, radius: float = 5e-3
) -> Hand:
    """Return a hand of two jaws that close along x, each by its own joint; the gripper points along z.

    Each pad has four parts, and so at most four contacts.

    The defaults are the pads of a Franka hand in the frame that ACRONYM's transforms give (Eppner et al. 2021), whose
    fingers end 0.1122 m along z. A joint slides from 0, open, to half the opening, closed.

    Args:
        opening: between the open pads [m].
        reach: where the pads begin and end along z [m].
        width: of the pads, along y [m].
        radius: of the spheres that a pad is made of, whose flesh ends at the pad's plane [m].

    Raises:
        ValueError: for sizes that are not positive, or pads too small for their spheres.
    """
    sizes = {"opening": opening, "width": width, "radius": radius, "reach": reach[1] - reach[0]}
    for name, size in sizes.items():
        if not (np.isfinite(size) and size > 0):
            raise ValueError(f"{name} is {size}: expected a positive length [m]")
    spans = [(-width / 2 + radius, width / 2 - radius), (reach[0] + radius, reach[1] - radius)]
    if min(high - low for low, high in spans) < 0:
        raise ValueError(
            f"radius is {radius}: expected at most half of the pads' sides, {width} and {sizes['reach']} m"
        )
    rows = 2 * max(1, round(COLUMNS * (reach[1] - reach[0]) / width / 2))
    across, along = (np.linspace(*span, count) for span, count in zip(spans, (COLUMNS, rows), strict=True))
    parts = [
        np.stack(np.meshgrid([radius], np.split(across, 2)[i], np.split(along, 2)[j], indexing="ij"), -1).reshape(-1, 3)
        for i, j in QUARTERS
    ]
    centers = np.concatenate([np.stack(parts) * [side, 1, 1] for side in (1, -1)])
    names = ("jaw +x", "jaw -x")
    half = opening / 2
    return Hand(
        origins=jnp.array([[half, 0, 0], [-half, 0, 0]]),
        rests=jnp.broadcast_to(jnp.eye(3), (2, 3, 3)),
        axes=jnp.array([[-1.0, 0, 0], [1.0, 0, 0]]),
        lower=jnp.zeros(2),
        upper=jnp.full(2, half),
        skin=Spheres(jnp.array(centers), jnp.full(centers.shape[:2], radius)),
        parents=(-1, -1),
        joints=names,
        links=tuple(
            Link(name, "-+"[i] + "y" + "-+"[j] + "z", jaw) for jaw, name in enumerate(names) for i, j in QUARTERS
        ),
        sliding=names,
    )
