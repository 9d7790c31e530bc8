"""Jobs as differentiable functions of numbers and fields, for programs that learn and optimise."""
