"""Errors of trajectories and meshes against ground truth, under named protocols, and pictures of them."""
