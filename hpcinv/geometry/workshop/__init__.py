"""Shapes of runs for manufacture: closed surfaces and moulds."""
