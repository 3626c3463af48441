"""The one door to a trained object: load, pose, render, save, train."""
