"""Contact sets of simulated grips: two hand models close on simple objects, and what touches is kept.

``hands`` and ``objects`` build the models, ``close`` simulates one grip from its seed, and ``make`` writes
the file ``jaxgrasp/data/simulated_grips.npz``.
"""
