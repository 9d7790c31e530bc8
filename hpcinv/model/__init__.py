"""The model of a scene: its spaces, supports, parameters and virtual work."""
