"""PAPR: networks, renderer, checkpoints."""
