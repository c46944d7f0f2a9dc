"""Procedures that choose the next stimulus, each decided by its seed and the answers so far alone."""
