"""Force distribution as the literature before the paper has it (section II-D): each method by its own formulation.

They are rivals and references: every one takes the same grasps and wrenches and answers with one type, so that they
can be compared with each other, with the closed forms and with the constrained optimum. None is differentiable.
"""
