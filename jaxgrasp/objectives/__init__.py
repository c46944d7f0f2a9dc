"""Contact forces by other objectives than closeness to the squeezing forces."""
