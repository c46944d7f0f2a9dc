"""Command line ``jaxgrasp COMMAND``. Arguments are understood before JAX is imported."""
