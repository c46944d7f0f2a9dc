"""The numbers that the paper prints, as data: nothing here computes."""
