"""The paper's closed form, which ignores friction: what the optimum's time and its forces are compared with."""

import jaxgrasp
from benchmarks.rivals.by_jaxgrasp import in_both_precisions

RIVALS = in_both_precisions("closed_form", jaxgrasp.closed_form, "none")
