"""A vocabulary of ORB descriptors, learnt from a recording: a tree of words for place recognition (Gálvez-López and Tardós, T-RO 2012).

ORB-SLAM3's own is a download of 139 MB. This one is made of the recording's own frames, as the text that ORB-SLAM3 reads: `k L scoring
weighting`, then for each node `parent leaf 32 bytes weight`, parents before their children.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from idfslam.benchmark.peers.peer import PeerError
from idfslam.datasets import Dataset
from idfslam.errors import FrameError
from idfslam.geometry.even_spacing import evenly_spread

Bits = NDArray[np.float32]  # (M, 256) of -1 and 1: the Hamming distance is (256 - a . b) / 2

BRANCHES, LEVELS = 10, 6  # of the tree, as in ORB-SLAM3's own; raised, there are more words
_IMAGES = 150  # of the recording, evenly spread; raised, more words, and more time. Chosen by hand
_FEATURES = 1000  # of an image, as ORB-SLAM3 takes; raised, more words, and more time
_WORD = 20  # descriptors of a node that is not split further; raised, fewer and coarser words. Chosen by hand
_ITERATIONS = 8  # of k-means at most; raised, slower, slightly better words. Chosen by hand


@dataclass
class _Node:
    """A node, its descriptors, and what is below it."""

    centre: Bits  # (256,)
    members: NDArray[np.int64]  # (M,) indices of descriptors
    level: int
    children: list["_Node"] = field(default_factory=list)


def recorded_descriptors(recording: Dataset) -> list[NDArray[np.uint8]]:
    """ORB descriptors (M, 32) of frames spread over the recording. Raises PeerError if they have next to none."""
    detector = cv2.ORB_create(_FEATURES)  # type: ignore[attr-defined] # its type stubs lack the detectors
    found = []
    for i in evenly_spread(len(recording), _IMAGES).tolist():
        try:
            colour = recording[i].colour
        except FrameError:
            continue
        _, descriptors = detector.detectAndCompute(cv2.cvtColor((colour * 255).astype(np.uint8), cv2.COLOR_RGB2GRAY), None)
        if descriptors is not None:
            found.append(descriptors)
    if sum(map(len, found)) < BRANCHES**2:
        raise PeerError(f"{recording.name}: shows fewer than {BRANCHES**2} ORB features, too few for a vocabulary")
    return found


def write_vocabulary(path: Path, images: Sequence[NDArray[np.uint8]], seed: int) -> int:
    """Learns a vocabulary from the descriptors (M, 32) of each image and writes it. Returns the number of its words."""
    bits = np.where(np.unpackbits(np.concatenate(images), axis=1), np.float32(1), np.float32(-1))
    image_of = np.repeat(np.arange(len(images)), [len(descriptors) for descriptors in images])
    root = _Node(np.zeros(256, np.float32), np.arange(len(bits)), 0)
    nodes, generator = list[tuple[int, _Node]](), np.random.default_rng(seed)
    waiting = [(0, root)]
    while waiting:  # by breadth, so that parents are numbered before their children
        number, node = waiting.pop(0)
        _split(node, bits, generator)
        for child in node.children:
            nodes.append((number, child))
            waiting.append((len(nodes), child))
    lines = [f"{BRANCHES} {LEVELS} 0 0"]  # scoring by L1, weights by tf-idf
    for parent, node in nodes:
        weight = 0.0 if node.children else float(np.log(len(images) / len(np.unique(image_of[node.members]))))
        descriptor = np.packbits(node.centre > 0)
        lines.append(f"{parent} {int(not node.children)} {' '.join(map(str, descriptor))} {weight:.6f}")
    path.write_text("\n".join(lines), encoding="ascii")  # without a last line break, which would be read as one more node
    return sum(not node.children for _, node in nodes)


def _split(node: _Node, bits: Bits, generator: np.random.Generator) -> None:
    """Gives the node its children. The first two levels are always split: ORB-SLAM3 looks for every word's ancestor on the second."""
    if node.level == LEVELS or len(node.members) < 2 or (node.level >= 2 and len(node.members) < _WORD):
        if node.level < 2:
            node.children = [_Node(node.centre, node.members, node.level + 1)]
        return
    for centre, members in _clusters(bits[node.members], generator):
        node.children.append(_Node(centre, node.members[members], node.level + 1))


def _clusters(bits: Bits, generator: np.random.Generator) -> list[tuple[Bits, NDArray[np.int64]]]:
    """At most BRANCHES clusters by k-means with majority votes; each a centre (256,) and indices. One alone where all are equal."""
    centres = bits[generator.choice(len(bits), min(BRANCHES, len(bits)), replace=False)]
    owner = np.full(len(bits), -1)
    for _ in range(_ITERATIONS):
        nearest = (bits @ centres.T).argmax(1)
        if (nearest == owner).all():
            break
        owner = nearest
        votes = np.eye(len(centres), dtype=np.float32)[owner].T @ bits
        centres = np.where(votes >= 0, np.float32(1), np.float32(-1))
    return [(centres[k], np.flatnonzero(owner == k)) for k in range(len(centres)) if (owner == k).any()]
