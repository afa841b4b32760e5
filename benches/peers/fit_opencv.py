"""OpenCV: one of its three ellipse fits on every profile, then a line through the centres: least squares, or robust."""

from collections.abc import Callable
from typing import Any

import cv2
import numpy as np

from protocol import Fit, Hints, Pose, pose_from_line, serve

#: From points to ((centre), (axes), angle).
EllipseFit = Callable[..., Any]


def centres(profiles: list[np.ndarray], fit: EllipseFit) -> np.ndarray:
    """(x, y, z, semi-minor axis) of every profile; centred first, since OpenCV calculates in single precision."""
    found = []
    for profile in profiles:
        origin = profile.mean(axis=0)
        (y, z), axes, _ = fit((profile[:, 1:] - origin[1:]).astype(np.float32))
        found.append((profile[0, 0], y + origin[1], z + origin[2], min(axes) / 2.0))
    return np.array(found)


def least_squares_line(found: np.ndarray) -> Pose:
    """The line that numpy's polynomial fit gives."""
    (p, y0), (q, z0) = np.polyfit(found[:, 0], found[:, 1:3], 1).T
    return Pose(np.array([0.0, y0, z0]), np.array([1.0, p, q]), float(np.median(found[:, 3])))


def robust_line(found: np.ndarray) -> Pose:
    """OpenCV's own line by an M-estimator, after ellipses that no profile of the part can have are dropped."""
    points = found[:, :3].astype(np.float32)
    line = cv2.fitLine(points, cv2.DIST_HUBER, 0, 0.001, 0.00001).ravel().astype(np.float64)
    return pose_from_line(line[3:], line[:3], float(np.median(found[:, 3])))


def plausible(found: np.ndarray, hints: Hints) -> np.ndarray:
    """Those with a radius within the hint; all of them where that leaves too few."""
    kept = found[(found[:, 3] >= hints.radius_min) & (found[:, 3] <= hints.radius_max)]
    return kept if len(kept) >= 3 else found


def variant(fit: EllipseFit, robust: bool) -> Fit:
    """The fit, with the line that goes with it."""

    def run(profiles: list[np.ndarray], hints: Hints) -> Pose:
        found = centres(profiles, fit)
        return robust_line(plausible(found, hints)) if robust else least_squares_line(found)

    return run


if __name__ == "__main__":
    fits: dict[str, EllipseFit] = {
        "ellipse": cv2.fitEllipse,
        "ams": cv2.fitEllipseAMS,
        "direct": cv2.fitEllipseDirect,
    }
    serve(
        {f"{name}_{line}": variant(fit, line == "robust") for name, fit in fits.items() for line in ("line", "robust")}
    )
