"""Linear solvers: two presets, and the rule that chooses between them."""
