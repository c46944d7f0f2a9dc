"""Types that all other layers use, and their conventions."""
