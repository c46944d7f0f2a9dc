"""Seeded problems, independent references and timed comparisons; shared with the tests, not installed."""

import os

# Benchmarks measure the JAX solver, also where the extra `kernel` is installed; benchmarks/kernel.py switches it on.
os.environ.setdefault("JAXGRASP_KERNEL", "0")
