"""The constrained optimum and its relatives: phases over a batch, Newton on the dual, derivatives, proofs."""
