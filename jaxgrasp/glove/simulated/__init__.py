"""Simulated glove: fingers, cables, a slow line and its faults, in real or in virtual time."""
