"""Errors that a user can correct. Each message says what was found, what was expected and what to do."""

import sys

_HALF = 800  # characters at either end of a message that are shown; raised, messages are longer. Chosen by hand


def pip_install(*packages: str, python: str | None = None) -> str:
    """The command that installs packages where this program runs, from a clone as from a wheel. python: for this one instead."""
    chosen = python or sys.executable
    quoted = f'"{chosen}"' if " " in chosen else chosen
    return f"{quoted} -m pip install {' '.join(packages)}"


class IdfSlamError(Exception):
    """Base of all errors that a user can correct; the command line prints the message and exits with status 1."""

    def __str__(self) -> str:
        """The message in one line, without its middle if it is very long: it may quote what a file or another package says."""
        text = " ".join(super().__str__().split())
        return text if len(text) <= 2 * _HALF else f"{text[:_HALF]} ... {text[-_HALF:]}"


class RecordingError(IdfSlamError):
    """A recording that cannot be used as a whole: missing files, unknown layout or camera, mismatched counts."""


class CameraError(IdfSlamError):
    """A live camera that is not connected, does not give what is needed, or was disconnected."""


class FrameError(IdfSlamError):
    """One frame that cannot be used: unreadable in a recording, where the run counts it as lost, or made of images that are none."""


class ConfigError(IdfSlamError):
    """A configuration that cannot work: unknown key, value out of range, missing package or device."""


class ResultError(IdfSlamError):
    """A result folder that lacks what a command needs, or holds a file of another version."""


class ArchiveError(IdfSlamError):
    """A zip or tar file that is damaged, encrypted or made to do harm."""


class DownloadError(IdfSlamError):
    """A public sequence that cannot be downloaded: unknown, not reachable, damaged, or its folder exists already."""


class DivergedError(IdfSlamError):
    """A loss that is not finite; the message names the keyframe and the loss."""
