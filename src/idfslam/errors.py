"""The user's mistakes: each says what was found, what was expected and what to do."""


class IdfSlamError(Exception):
    """Root of all errors that a user can mend; the command line prints the message and exits with 1."""


class RecordingError(IdfSlamError):
    """A recording that cannot be used as a whole: missing files, unknown layout or camera, mismatched counts."""


class CameraError(IdfSlamError):
    """A live camera that is not there, is not what it should be, or is gone."""


class FrameError(IdfSlamError):
    """One frame of a recording that cannot be read; the run goes on and treats the frame as lost."""


class ConfigError(IdfSlamError):
    """A configuration that cannot work: unknown key, value out of range, missing package or device."""


class ResultError(IdfSlamError):
    """A result folder that lacks what a command needs, or holds a file of another version."""


class DownloadError(IdfSlamError):
    """A public sequence that cannot be had: unknown, not reachable, damaged, or in the way of something else."""


class DivergedError(IdfSlamError):
    """A loss that is not finite; names the keyframe and the loss."""
