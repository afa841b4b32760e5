"""pyransac3d: its Cylinder on a sample of the points; all of them would take minutes."""

import random

import numpy as np
import pyransac3d

from protocol import Hints, NoPose, Pose, pose_from_line, serve

SAMPLE_COUNT, ITERATIONS_COUNT = 5_000, 1_000


def fit(profiles: list[np.ndarray], hints: Hints) -> Pose:
    """As its documentation shows; the threshold is wide, since no candidate passes through a point exactly."""
    random.seed(0)
    points = np.concatenate(profiles)
    points = points[:: max(1, len(points) // SAMPLE_COUNT)]
    with np.errstate(all="ignore"):
        found = pyransac3d.Cylinder().fit(
            points, thresh=max(3.0 * hints.noise, 0.005 * hints.radius), maxIteration=ITERATIONS_COUNT
        )
    if len(found.axis) != 3:
        raise NoPose("no cylinder found")
    return pose_from_line(np.asarray(found.center), np.asarray(found.axis), float(found.radius))


if __name__ == "__main__":
    serve({"cylinder": fit})
