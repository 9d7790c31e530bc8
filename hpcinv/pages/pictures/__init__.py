"""Pictures of bodies and results, drawn without a display."""
