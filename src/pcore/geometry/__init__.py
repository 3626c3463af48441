"""Cameras, rays, point clouds, neighbours: tensors in, tensors out."""
