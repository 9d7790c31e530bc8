"""Interfaces: two surfaces of one mesh that are tied, slide on each other, or are in contact."""
