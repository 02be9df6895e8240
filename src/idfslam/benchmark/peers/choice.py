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
        raise ConfigError(f"{name}: no known system to compare with, expected one of {', '.join(PEERS)}")
    return PEERS[name]


def pythons(given: Sequence[str]) -> dict[str, str]:
    """The Python for each peer, from words NAME=PYTHON; without one, that of this program. `fusion` takes Open3D's if it has none.

    Raises ConfigError for another form, an unknown name, or a Python that is none.
    """
    named: dict[str, str] = {}
    for word in given:
        name, equals, python = word.partition("=")
        if not equals or not python:
            raise ConfigError(f"--peer-python {word}: expected NAME=PYTHON, such as open3d=/path/to/environment/bin/python")
        found = shutil.which(os.path.expanduser(python))
        if found is None:
            raise ConfigError(f"--peer-python {word}: {python} is no program that can be run; expected the Python of an environment")
        named[find_peer(name).name] = os.path.abspath(found)
    named.setdefault("fusion", named.get("open3d", sys.executable))
    return {name: named.get(name, sys.executable) for name in PEERS}
