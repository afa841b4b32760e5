"""SciPy: least_squares with Cauchy loss on the orthogonal distances of a cylinder, in stages from a coarse scale to
the noise, with the derivatives written out. The start is what a user would write down first: the middle of what is
seen, one radius below its top. A cloud is first laid along its longest principal axis with the sensor above, and cut into
200 slabs for the start.
"""

import numpy as np
from scipy.optimize import least_squares
from scipy.stats import theilslopes

from protocol import Hints, NoPose, Pose, serve

#: Points of the coarse stages, and of the last one in the variant that samples.
COARSE_COUNT, SAMPLE_COUNT = 5_000, 50_000
#: Scales of the loss, as multiples of the noise: the coarse stages, and the last.
COARSE, FINE = (400.0, 60.0, 10.0), 2.0
#: Slabs of a cloud for the start.
SLABS_COUNT = 200


def distances(unknown: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Signed orthogonal distance of each point (x from mid scan, y, z) from the cylinder (p, q, y, z, R)."""
    p, q, y, z, radius = unknown
    u, w = points[:, 1] - y - p * points[:, 0], points[:, 2] - z - q * points[:, 0]
    return np.sqrt(u * u + w * w - (p * u + q * w) ** 2 / (1.0 + p * p + q * q)) - radius


def derivatives(unknown: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Of the distances."""
    p, q, y, z, radius = unknown
    u, w = points[:, 1] - y - p * points[:, 0], points[:, 2] - z - q * points[:, 0]
    s = (p * u + q * w) / (1.0 + p * p + q * q)
    rho = distances(unknown, points) + radius
    across, up = -(u - p * s) / rho, -(w - q * s) / rho
    lever = points[:, 0] + s
    return np.stack([across * lever, up * lever, across, up, np.full_like(rho, -1.0)], axis=1)


def start(profiles: list[np.ndarray], x_mid: float, hints: Hints) -> np.ndarray:
    """Robust slopes of the profiles' middles, and the radius that was told."""
    some = profiles[:: max(1, len(profiles) // 200)]
    x = np.array([profile[0, 0] for profile in some]) - x_mid
    y = np.array([(profile[:, 1].min() + profile[:, 1].max()) / 2.0 for profile in some])
    top = np.array([np.median(profile[:, 2]) for profile in some])
    p, q = theilslopes(y, x)[0], theilslopes(top, x)[0]
    z_top = np.median([np.quantile(profile[:, 2], 0.95) for profile in some])
    return np.array([p, q, np.median(y), z_top - hints.radius, hints.radius])


def solve(unknown: np.ndarray, points: np.ndarray, scale: float, tolerance: float) -> np.ndarray:
    """One stage, from `unknown`."""
    return least_squares(
        distances, unknown, derivatives, loss="cauchy", f_scale=scale, x_scale=[1e-3, 1e-3, 1.0, 1.0, 1.0],
        ftol=tolerance, xtol=tolerance, max_nfev=30, args=(points,),
    ).x  # fmt: skip


def laid_along_x(points: np.ndarray, hints: Hints) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The points along their longest principal axis with the sensor above; the rotation's rows, and the origin."""
    origin = points.mean(axis=0)
    along = np.linalg.eigh(np.cov((points - origin).T))[1][:, 2]
    up = np.array(hints.towards_sensor)
    up -= (up @ along) * along
    up /= np.linalg.norm(up)
    rotation = np.stack([along, np.cross(up, along), up])
    return (points - origin) @ rotation.T, rotation, origin


def fit(profiles: list[np.ndarray], hints: Hints, all_points: bool) -> Pose:
    """The stages one after the other."""
    if len(profiles) > 1:
        return fit_along_x(profiles, hints, all_points)
    points, rotation, origin = laid_along_x(profiles[0], hints)
    points = points[np.argsort(points[:, 0])]
    pose = fit_along_x(np.array_split(points, SLABS_COUNT), hints, all_points)
    return Pose(origin + pose.point @ rotation, pose.direction @ rotation, pose.radius)


def fit_along_x(profiles: list[np.ndarray], hints: Hints, all_points: bool) -> Pose:
    """The stages for an axis near X."""
    x_mid = (profiles[0][0, 0] + profiles[-1][0, 0]) / 2.0
    points = np.concatenate(profiles) - (x_mid, 0.0, 0.0)
    chosen = np.random.default_rng(0).integers(len(points), size=SAMPLE_COUNT)
    sample = points[chosen]
    unknown = start(profiles, x_mid, hints)
    for scale in COARSE:
        unknown = solve(unknown, sample[:COARSE_COUNT], scale * hints.noise, 1e-5)
    unknown = solve(unknown, points if all_points else sample, FINE * hints.noise, 1e-8)
    p, q, y, z, radius = unknown
    if not hints.radius_min <= radius <= hints.radius_max:
        raise NoPose(f"a radius of {radius:.1f} mm")
    return Pose(np.array([x_mid, y, z]), np.array([1.0, p, q]), radius)


if __name__ == "__main__":
    serve({
        "sample": lambda profiles, hints: fit(profiles, hints, all_points=False),
        "all": lambda profiles, hints: fit(profiles, hints, all_points=True),
    })  # fmt: skip
