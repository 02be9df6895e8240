"""ATE and RPE of a trajectory against ground truth, both in TUM format (t tx ty tz qx qy qz qw, camera-to-world).

Usage: python examples/evaluate_trajectory.py ESTIMATE.txt TRUTH.txt
"""

import sys
from pathlib import Path

from rich import print

from idfslam.evaluation.evaluate import evaluate_poses
from idfslam.evaluation.table import table
from idfslam.evaluation.trajectory_error import matched_ground_truth
from idfslam.geometry.trajectory import load_tum

estimate, truth = (load_tum(Path(name)) for name in sys.argv[1:3])
evaluation = evaluate_poses(estimate.poses, matched_ground_truth(estimate, truth))  # frames matched by time stamp, aligned without scale
print(table(evaluation))
print(f"ATE RMSE {evaluation.ate.translation.rmse * 100:.2f} cm")
