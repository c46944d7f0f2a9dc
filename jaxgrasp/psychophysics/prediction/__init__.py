"""Predictions for an experiment before it is run: precision, coverage, and effects of the device's errors."""
