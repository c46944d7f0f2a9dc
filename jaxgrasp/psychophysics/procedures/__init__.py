"""Which stimulus comes next: each procedure is decided by its seed and the answers so far, and by nothing else."""
