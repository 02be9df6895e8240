"""Keyframes, landmarks and the camera adjusted together, while a run goes on and at its end."""
