"""The force-feedback glove: joint torques to bytes and sensors back, in NumPy alone; nothing here imports JAX."""
