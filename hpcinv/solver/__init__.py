"""Solution of the nonlinear equations: Newton's method, load stepping and arc-length continuation."""
