"""What a person runs: ``jaxgrasp COMMAND``. Arguments are understood before JAX is imported."""
