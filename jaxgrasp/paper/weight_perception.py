"""What section III-C of the paper prints beside Table III: the design, the results, and the tests of them."""

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
