"""I/O side of the haptic loop: the process that owns the line, and its exchange with the computing side."""
