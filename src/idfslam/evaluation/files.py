"""The files that an evaluation writes into the folder of the results."""

EVALUATION, TRAJECTORY_PICTURE, ERROR_PICTURE = "evaluation.json", "trajectory.png", "error.png"
FILES = (EVALUATION, TRAJECTORY_PICTURE, ERROR_PICTURE)
