"""The embedded object: its mesh, pictures and deformed states."""
