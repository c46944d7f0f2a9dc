"""Native protocol: frames, the reference device, and the specification and C program for building firmware."""
