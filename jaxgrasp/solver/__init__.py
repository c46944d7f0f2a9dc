"""The constrained optimum and its relatives: passes over a batch, Newton on the dual, derivatives, proofs."""
