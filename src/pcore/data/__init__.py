"""Scenes, views, images and point files."""
