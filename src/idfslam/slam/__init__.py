"""The system of Fig. 2: a front end that tracks, a back end that maps, and the recovery of lost cameras."""

from idfslam.slam.slam import Slam

__all__ = ["Slam"]
