"""What every peer speaks: `peer VARIANT SCAN HINTS [REPEATS]` prints one line of JSON, the pose and the seconds that
each estimation took from points in memory. The pose is the axis as y = y0 + p x, z = z0 + q x; peers that take clouds in any
orientation state it as point and direction as well. Here for the peers in Python. Must not know any method.
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
    """The axis through a point along a direction and the radius, mm."""

    point: np.ndarray
    direction: np.ndarray
    radius: float

    def stated(self) -> dict[str, object]:
        """As it is printed; an axis square to X has no slopes, and no number of JSON either."""
        x, y, z = (float(value) for value in self.direction)
        p, q = (y / x, z / x) if x else (1e300, 1e300)
        line = {"p": p, "q": q, "y0": float(self.point[1]) - p * float(self.point[0])}
        line |= {"z0": float(self.point[2]) - q * float(self.point[0]), "radius": float(self.radius)}
        return line | {"point": [float(value) for value in self.point], "direction": [x, y, z]}


@dataclass(frozen=True)
class Hints:
    """What a peer is told besides the scan. Lengths in mm."""

    radius: float
    radius_min: float
    radius_max: float
    noise: float
    pitch: float
    towards_sensor: list[float]


class NoPose(Exception):
    """The method says itself that it found nothing."""


#: From profiles, a list of (x, y, z) arrays, to a pose.
Fit = Callable[[list[np.ndarray], Hints], Pose]


def load(path: Path) -> list[np.ndarray]:
    """The profiles of a scan in double precision, without missing points; a cloud is one of them."""
    scan = np.load(path).astype(np.float64)
    return [row[~np.isnan(row[:, 2])] for row in (scan if scan.ndim == 3 else scan[None])]


def pose_from_line(point: np.ndarray, direction: np.ndarray, radius: float) -> Pose:
    """The pose of an axis through `point` along `direction`."""
    return Pose(point, direction, radius)


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
            answer = pose.stated()
        except NoPose as reason:
            answer = {"refused": str(reason)}
        seconds.append(time.perf_counter() - start)
    print(json.dumps(answer | {"seconds": seconds}))
