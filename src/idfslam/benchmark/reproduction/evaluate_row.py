"""Measures a run by the protocol of the paper's tables, as a process of its own.

python -m idfslam.benchmark.reproduction.evaluate_row DIR [--gt-mesh FILE]
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from idfslam.errors import IdfSlamError
from idfslam.runs.evaluate_run import evaluate_folder

PROTOCOL = "nice"  # which the paper follows


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--gt-mesh", type=Path)
    flags = parser.parse_args(arguments)
    try:
        evaluate_folder(flags.folder, gt_mesh=flags.gt_mesh, protocol=PROTOCOL, views=0)  # the tables have no depth L1
    except IdfSlamError as error:
        print(f"error: {error}", file=sys.stderr)
        raise SystemExit(1) from None


if __name__ == "__main__":
    main()
