"""What a wrong argument is told: its name, what came and what was expected, before any work; needs no JAX."""
