"""Poses in files, and the ground truth of a recording."""
