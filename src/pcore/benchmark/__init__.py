"""Benchmarks of one's own: true pictures and true maps of the deformed states of any model."""
