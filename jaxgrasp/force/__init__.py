"""Contact forces from grasp and wrench: the closed forms, the constrained optimum, and their angles."""
