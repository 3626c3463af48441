"""Poses of trained objects found from photos of their deformed states."""
