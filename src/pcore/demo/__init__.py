"""The story of `pcore demo`: its folder, its comparison, its page."""
