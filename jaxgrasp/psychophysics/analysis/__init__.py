"""From answers to thresholds, with what they leave open."""
