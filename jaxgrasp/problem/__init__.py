"""From what users pass to the arrays that the solver works on, and back: batch-last, centred, scaled."""
