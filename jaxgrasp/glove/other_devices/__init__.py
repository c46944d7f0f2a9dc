"""Devices that others make: LucidGloves, Polhemus trackers."""
