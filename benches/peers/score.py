"""A pose against the truth. Success: angles within 0.02° and offsets at x = 0 within 0.3 mm. Of a turned cloud, whose axis
may lie in any direction: the angle between the axes, and the distance of the true point at x = 0 from the axis found. Must
not know who found it.
"""

import math
from dataclasses import dataclass
from typing import Any

ANGLE_MAX_DEG, OFFSET_MAX_MM = 0.02, 0.3


@dataclass(frozen=True)
class Score:
    """How far a pose is off."""

    success: bool
    #: The larger of deflection's and pitch's error.
    angle_deg: float
    #: Distance of the axes in the plane x = 0, the larger of y's and z's.
    offset_mm: float
    #: Distance of the axes in the plane of mid scan.
    mid_mm: float
    radius_mm: float
    #: The Cramér-Rao bounds of the two.
    bound_deg: float
    bound_mid_mm: float


def score(pose: dict[str, Any], truth: dict[str, Any]) -> Score:
    """Compares two axes and their radii."""
    return of_any_direction(pose, truth) if "axis" in truth else of_slopes(pose, truth)


def of_any_direction(pose: dict[str, Any], truth: dict[str, Any]) -> Score:
    """Compares two axes by point and direction."""
    axis, direction = truth["axis"], unit(pose["direction"])
    angle = math.degrees(math.asin(min(1.0, math.hypot(*cross(direction, axis["direction"])))))
    offset, mid = (
        math.hypot(*cross([a - b for a, b in zip(axis[place], pose["point"], strict=True)], direction))
        for place in ("origin", "mid")
    )
    success = angle <= ANGLE_MAX_DEG and offset <= OFFSET_MAX_MM
    radius = abs(pose["radius"] - truth["radius"])
    return Score(success, angle, offset, mid, radius, truth["bound_deg"], truth["bound_mid"])


def unit(vector: list[float]) -> list[float]:
    """The vector with length 1."""
    length = math.hypot(*vector)
    return [value / length for value in vector]


def cross(a: list[float], b: list[float]) -> list[float]:
    """The cross product."""
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def of_slopes(pose: dict[str, Any], truth: dict[str, Any]) -> Score:
    """Compares two axes (p, q, y0, z0) and their radii."""
    angle = max(abs(math.degrees(math.atan(pose[slope]) - math.atan(truth[slope]))) for slope in "pq")
    off_y, off_z = pose["y0"] - truth["y0"], pose["z0"] - truth["z0"]
    offset, x = max(abs(off_y), abs(off_z)), truth["x_mid"]
    mid = math.hypot(off_y + x * (pose["p"] - truth["p"]), off_z + x * (pose["q"] - truth["q"]))
    success = angle <= ANGLE_MAX_DEG and offset <= OFFSET_MAX_MM
    radius = abs(pose["radius"] - truth["radius"])
    return Score(success, angle, offset, mid, radius, truth["bound_deg"], truth["bound_mid"])
