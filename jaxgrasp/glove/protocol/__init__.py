"""The native protocol: frames, what a device does with them, and the page and C program to build firmware by."""
