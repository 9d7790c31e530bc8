"""Physics at a point: kinematics of both directions, material laws, effects, and the programs that evaluate them."""
