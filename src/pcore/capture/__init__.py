"""Captures: folders of photos in the layouts that users' tools write, read into scenes."""
