"""Checks of arguments before any work: errors name the argument, its value and the expectation; JAX is not needed."""
