"""The confidence that ARKit states for each reading of depth: 0 low (guessed from the image rather than measured), 1 medium, 2 high."""

MEDIUM = 1  # least confidence of readings that are used; raised, less depth is used, and little of it far away
