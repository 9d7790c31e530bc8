"""What happens at a quadrature point: forms and expressions as programs of scalar operations, which are interpreted."""
