"""The peers by name, and the Pythons that the user names for them."""

import os
import shutil
import sys
from collections.abc import Mapping, Sequence

from idfslam.benchmark.peers.fusion import Fusion
from idfslam.benchmark.peers.open3d import Open3d
from idfslam.benchmark.peers.orbslam3 import OrbSlam3
from idfslam.benchmark.peers.peer import Peer
from idfslam.benchmark.peers.rtabmap import RtabMap
from idfslam.errors import ConfigError

PEERS: Mapping[str, Peer] = {peer.name: peer for peer in (Open3d(), OrbSlam3(), RtabMap(), Fusion())}


def find_peer(name: str) -> Peer:
    """The peer of this name. Raises ConfigError, which lists all names, if there is none."""
    if name not in PEERS:
        raise ConfigError(f"--against {name}: no known system, expected some of {', '.join(PEERS)}, each with =PYTHON if wanted")
    return PEERS[name]


def chosen(words: Sequence[str]) -> dict[str, str]:
    """The peers that words NAME or NAME=PYTHON name, and the Python of each; without one, that of this program.

    `fusion` without one takes that of `open3d`. Raises ConfigError for an unknown name, a name that stands twice, or a Python that is none.
    """
    found: dict[str, str] = {}
    for word in words:
        name, equals, python = word.partition("=")
        if find_peer(name).name in found:
            raise ConfigError(f"--against {word}: {name} stands twice, expected each once")
        found[name] = _program(word, python) if equals else ""
    found = {name: python or (found.get("open3d", "") if name == "fusion" else "") for name, python in found.items()}
    return {name: python or sys.executable for name, python in found.items()}


def _program(word: str, python: str) -> str:
    place = shutil.which(os.path.expanduser(python)) if python else None
    if place is None:
        raise ConfigError(f"--against {word}: {python or 'nothing'} is no program that can be run, expected NAME=PYTHON of an environment")
    return os.path.abspath(place)
