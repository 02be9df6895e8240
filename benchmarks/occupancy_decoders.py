"""Trains the decoders of `--map-representation occupancy_grids` on generated rooms, and says how well they tell free from occupied space.

    OMP_NUM_THREADS=1 python benchmarks/occupancy_decoders.py --out occupancy_decoders.safetensors

The shipped file is the one of the default values (docs/model-card.md).
"""

import logging
from dataclasses import fields
from pathlib import Path

import tyro

from idfslam.pretraining.occupancy_decoders import DecoderTraining, save_decoders, train


def main(out: Path, training: DecoderTraining = DecoderTraining()) -> None:  # noqa: B008 (tyro shows the values)
    """Trains, writes the decoders, and prints the loss of the first and the last ten episodes."""
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    field, losses = train(training)
    save_decoders(out, field, training)
    values = ", ".join(f"{f.name} {getattr(training, f.name)}" for f in fields(training))
    print(
        f"{values}\nloss of the first ten episodes {sum(losses[:10]) / 10:.4f}, of the last ten {sum(losses[-10:]) / len(losses[-10:]):.4f}"
    )


if __name__ == "__main__":
    tyro.cli(main)
