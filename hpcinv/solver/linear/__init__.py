"""Linear solvers: two configurations, and the rule that chooses between them."""
