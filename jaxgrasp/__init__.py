"""Contact forces of a grasp: the paper's closed forms and the friction-cone optimum, batched and differentiable.

The public names below load on first use, so that parts which need no JAX can be imported without it.
"""
