"""The grasp over time: whether it holds, and what the object does."""
