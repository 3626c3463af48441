"""Learned skinning, which the paper has and the default does not need."""
