"""Command line ``jaxgrasp COMMAND``. It parses arguments before it imports JAX."""
