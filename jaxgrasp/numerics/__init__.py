"""Arithmetic that knows nothing of grasps: vectors in components, small factorisations."""
