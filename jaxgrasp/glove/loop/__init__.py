"""The haptic loop's I/O side: a process that owns the line, and what it and the computing side tell each other."""
