"""Places that are seen again: a lost camera, loops, and submaps that meet."""
