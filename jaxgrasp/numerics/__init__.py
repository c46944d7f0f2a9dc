"""Arithmetic that is independent of grasps: vectors in components, small factorisations."""
