"""Tables I to III of the paper (Tzafestas 2003)."""

FINGERS = ("index", "middle", "ring", "little")
PHALANGES = ("proximal", "middle", "distal")
CONTRIBUTIONS = ((1.44, 1.44, 1.08, 0.72), (0.24, 0.24, 0.24, 0.12), (1.92, 2.16, 1.44, 0.96))
"""Table I: of phalanges (rows) and fingers (columns) in a cylindrical power grip [1]."""
CONTRIBUTION_TOTALS = (3.6, 3.84, 2.76, 1.8)
"""Table I's last row."""

CONTACTS = (3, 5, 10, 15, 20)
EXECUTION_TIMES = (2e-3, 2e-3, 3e-3, 5e-3, 7e-3)
"""Table II: of method B, by the number of contacts, on a workstation of 50 MHz [s]."""

REFERENCE_WEIGHTS = (1.0, 2.0, 3.0)
"""[N]"""
DIFFERENCES = (0.05, 0.10, 0.20, 0.30)
"""Differences of the comparison from the reference, by the reference."""
HIT_RATIOS = ((0.50, 0.61, 0.74, 0.79), (0.59, 0.67, 0.82, 0.93), (0.70, 0.76, 0.86, 0.91))
"""Table III: shares of correct answers, by reference weight (rows) and difference (columns); means of all subjects."""
