"""What an experiment will find, before it is run: precision, coverage, and what the device's errors do."""
