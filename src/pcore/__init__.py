"""Edit captured objects: neural points that stay hole-free under deformation."""
