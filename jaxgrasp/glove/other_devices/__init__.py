"""Third-party devices: LucidGloves and Polhemus trackers."""
