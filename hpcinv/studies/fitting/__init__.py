"""Fit of material laws to tests with homogeneous deformation; needs neither MPI nor DOLFINx."""
