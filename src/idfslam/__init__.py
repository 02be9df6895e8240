"""RGB-D SLAM with a neural tracker and a neural implicit map."""

__version__ = "0.1.0"
