"""How answers move with what they depend on: matrices, trajectories, and design, all by automatic differentiation."""
