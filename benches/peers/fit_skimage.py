"""scikit-image: RANSAC with EllipseModel on 80 profiles of 80 points, RANSAC with LineModelND through the centres.

Its distance from an ellipse solves an equation point by point in Python: all points of all profiles would take minutes.
"""

import warnings

import numpy as np
from skimage.measure import EllipseModel, LineModelND, ransac

from protocol import Hints, NoPose, Pose, pose_from_line, serve

PROFILES_COUNT, POINTS_COUNT = 80, 80


def every_nth(count: int, of: int) -> slice:
    """About `count` of so many."""
    return slice(None, None, max(1, of // count))


def centre(profile: np.ndarray, hints: Hints) -> tuple[float, float, float, float] | None:
    """(x, y, z, semi-minor axis) of a profile."""
    points = profile[every_nth(POINTS_COUNT, len(profile)), 1:]
    origin = points.mean(axis=0)

    def plausible(model: EllipseModel, *_: np.ndarray) -> bool:
        if not model:
            return False
        a, b = model.axis_lengths
        return hints.radius_min <= min(a, b) and max(a, b) <= hints.radius_max

    model, _ = ransac(
        points - origin, EllipseModel, min_samples=12, residual_threshold=3.0 * hints.noise,
        is_model_valid=plausible, max_trials=200, stop_probability=0.99, rng=0,
    )  # fmt: skip
    if not model:
        return None
    y, z = np.asarray(model.center) + origin
    return profile[0, 0], y, z, min(model.axis_lengths)


def fit(profiles: list[np.ndarray], hints: Hints) -> Pose:
    """Centres, then the line that most of them agree on."""
    found = [centre(profile, hints) for profile in profiles[every_nth(PROFILES_COUNT, len(profiles))]]
    centres = np.array([one for one in found if one is not None])
    if len(centres) < 3:
        raise NoPose(f"an ellipse on {len(centres)} profiles")
    line, _ = ransac(
        centres[:, :3], LineModelND, min_samples=2, residual_threshold=0.005 * hints.radius, max_trials=500, rng=0
    )
    if not line:
        raise NoPose("no line through the centres")
    return pose_from_line(line.origin, line.direction, float(np.median(centres[:, 3])))


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    serve({"ransac": fit})
