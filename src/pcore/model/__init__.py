"""PAPR: the networks and their sizes, nothing else."""
