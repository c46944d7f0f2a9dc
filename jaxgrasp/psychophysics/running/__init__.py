"""Running an experiment: each answer is on disk before the next question."""
