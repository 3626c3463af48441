"""Nearest-to-ray search and proximity attention: one function each, several backends."""
