"""Conversion of users' data into the solver's arrays and back: batch-last, centred, scaled."""
