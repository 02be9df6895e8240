from idfslam.config import FAST as FAST, PAPER as PAPER, Config as Config
from idfslam.datasets import open_recording as open_recording
from idfslam.frame import Frame as Frame, FrameResult as FrameResult, Status as Status
from idfslam.geometry.camera import Camera as Camera
from idfslam.slam import Slam as Slam

__version__: str
