"""Grasp and wrench to contact forces: the closed forms, the constrained optimum, and their angles."""
