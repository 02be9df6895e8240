"""Front ends: each gives a frame its pose."""
