"""A plain wall fills the view for a while: does a run survive it? Prints ATE and status counts before, in and after the passage.

python benchmarks/bare_wall.py [SEED] [--noise]
"""

import argparse
from collections import Counter

import numpy as np
import torch

from idfslam.datasets.generated.room import BARE_PASSAGE, SyntheticRoom
from idfslam.datasets.prefetch import Prefetch
from idfslam.evaluation.trajectory_error import absolute_trajectory_error
from idfslam.frame import Frame
from idfslam.slam import Slam


def main() -> None:
    """Runs frames up to 60 past the passage."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("seed", type=int, nargs="?", default=0, help="of the room")
    parser.add_argument("--noise", action="store_true", help="of a Kinect")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    first, last = BARE_PASSAGE
    room = SyntheticRoom(arguments.seed, last + 60, noise=arguments.noise, bare_wall=True)
    slam = Slam()
    for _, frame in Prefetch(room):
        assert isinstance(frame, Frame)
        slam.process(frame)
    poses, truth, statuses = slam.trajectory(), np.asarray(room.ground_truth), slam.statuses()
    print(f"whole run, {len(poses)} frames: ATE RMSE {100 * absolute_trajectory_error(poses, truth).translation.rmse:.2f} cm")
    for name, part in {"before": slice(0, first), "bare wall": slice(first, last), "after": slice(last, None)}.items():
        rmse = 100 * absolute_trajectory_error(poses[part], truth[part]).translation.rmse
        print(f"{name}: ATE RMSE {rmse:.2f} cm, {dict(Counter(s.value for s in statuses[part]))}")


if __name__ == "__main__":
    main()
