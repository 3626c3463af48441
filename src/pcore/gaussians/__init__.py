"""Three-dimensional Gaussians whose colours depend on the view, and how they are moved."""
