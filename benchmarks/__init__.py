"""Seeded problems, independent references and timed comparisons; shared with the tests, not installed."""
