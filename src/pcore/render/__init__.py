"""From rays to pictures: trace, surface, tiles."""
