from idfslam.config import FAST as FAST
from idfslam.config import PAPER as PAPER
from idfslam.config import Config as Config
from idfslam.datasets import open_recording as open_recording
from idfslam.frame import Frame as Frame
from idfslam.frame import FrameResult as FrameResult
from idfslam.frame import Status as Status
from idfslam.geometry.camera import Camera as Camera
from idfslam.slam import Slam as Slam

__version__: str
