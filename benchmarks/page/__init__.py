"""The sections of the page that compares the constrained optimum with its rivals."""
