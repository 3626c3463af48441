"""Scores of images, geometry and points; LPIPS."""
