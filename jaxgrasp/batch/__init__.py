"""Many grasps at once: files, streams, evaluation, and what its results say."""
