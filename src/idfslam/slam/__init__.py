"""The system of Fig. 2: a front end that tracks, a back end that maps, and the recovery of lost cameras."""

from idfslam.graph.keyframe import Keyframe
from idfslam.slam.back_end.back_end import BackEnd
from idfslam.slam.compose import BACK_ENDS, FRONT_ENDS, MAPS, System
from idfslam.slam.front_end.front_end import FrontEnd
from idfslam.slam.slam import Slam
from idfslam.slam.tracked import Evidence, Source, Tracked

__all__ = ["BACK_ENDS", "FRONT_ENDS", "MAPS", "BackEnd", "Evidence", "FrontEnd", "Keyframe", "Slam", "Source", "System", "Tracked"]
