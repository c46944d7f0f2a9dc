"""Thresholds from answers, with their intervals and findings."""
