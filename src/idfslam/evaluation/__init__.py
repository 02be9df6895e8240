"""Errors of trajectories and meshes against ground truth, under named protocols; plots of them."""
