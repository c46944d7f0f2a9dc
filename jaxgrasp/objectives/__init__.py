"""Other things to ask of contact forces than to stay close to the squeezing forces."""
