"""What every peer speaks: `peer VARIANT SCAN HINTS [REPEATS]` prints one line of JSON, the pose and the seconds that
each estimation took from points in memory. Here for the peers in Python. Must not know any method.
"""

import json
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np


@dataclass(frozen=True)
class Pose:
    """The axis y = y0 + p x, z = z0 + q x and the radius, mm."""

    p: float
    q: float
    y0: float
    z0: float
    radius: float


@dataclass(frozen=True)
class Hints:
    """What a peer is told besides the scan. Lengths in mm."""

    radius: float
    radius_min: float
    radius_max: float
    noise: float
    pitch: float


class NoPose(Exception):
    """The method says itself that it found nothing."""


#: From profiles, a list of (x, y, z) arrays, to a pose.
Fit = Callable[[list[np.ndarray], Hints], Pose]


def load(path: Path) -> list[np.ndarray]:
    """The profiles of a scan in double precision, without missing points."""
    return [row[~np.isnan(row[:, 2])] for row in np.load(path).astype(np.float64)]


def pose_from_line(point: np.ndarray, direction: np.ndarray, radius: float) -> Pose:
    """The pose of an axis through `point` along `direction`."""
    p, q = direction[1] / direction[0], direction[2] / direction[0]
    return Pose(p, q, point[1] - p * point[0], point[2] - q * point[0], radius)


def serve(variants: dict[str, Fit]) -> None:
    """Runs the variant that the command line names and prints what came of it."""
    variant, scan, hints = sys.argv[1], Path(sys.argv[2]), Hints(**json.loads(Path(sys.argv[3]).read_text()))
    repeats = int(sys.argv[4]) if len(sys.argv) > 4 else 1
    profiles, seconds = load(scan), []
    answer: dict[str, object] = {}
    for _ in range(repeats):
        start = time.perf_counter()
        try:
            pose = variants[variant](profiles, hints)
            answer = {name: float(value) for name, value in vars(pose).items()}
        except NoPose as reason:
            answer = {"refused": str(reason)}
        seconds.append(time.perf_counter() - start)
    print(json.dumps(answer | {"seconds": seconds}))
