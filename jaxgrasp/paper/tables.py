"""Tables I to III of the paper (Tzafestas 2003), and the design, results and tests of section III-C beside them."""

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


SUBJECTS = 5
SERIES = 5
REPEATS = 2
"""Presentations of each comparison in a series: once as the first weight, once as the second."""
TRIALS_IN_SERIES = 8
TRIALS_IN_SESSION = 40
TRIALS_OF_COMPARISON = 10
"""Trials of each comparison in a session."""

CRITERION = 0.75
"""Hit ratio at the just noticeable difference."""
JND = (0.24, 0.33, 0.41)
"""Just noticeable differences, by reference weight [N]."""
WEBER = (0.244, 0.163, 0.135)
WEBER_DEVIATIONS = (0.052, 0.035, 0.036)
"""Standard deviations of the Weber fractions."""
MEAN_WEBER = 0.149
"""Mean of the Weber fractions at 2 and 3 N."""
F_1_AND_3 = 18.1
"""F ratio in the analysis of variance of the Weber fractions at 1 and 3 N, F[1, 8], with p < 0.01."""
F_2_AND_3 = 1.7
"""F ratio in the analysis of variance of the Weber fractions at 2 and 3 N, F[1, 8], with p > 0.05."""
REAL_WEBER = 0.10
"""Weber fraction for weights in the real world, as the paper cites it."""
