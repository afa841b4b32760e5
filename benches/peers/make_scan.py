"""Makes the scan of a scene: an NPY array for those who read arrays, the same points as PCD, the truth and the hints.

The truth is derived, not fitted: a ray from the section's centre in direction φ meets the cylinder of radius R about
the axis (1, p, q) at t = R / √(1 − (p sin φ + q cos φ)² / (1 + p² + q²)). Must not know who measures the scan.
"""

import json
import sys
import zlib
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from scenes import SCENES, Scene

#: Blocks of equal features along the part: a clamp or a hole is longer than one profile.
BLOCKS_COUNT = 50
#: Depths and heights, mm, on parts of at least 100 mm radius; less on smaller ones, in proportion.
SCREW_HOLE_DEPTHS, STRAIGHT_HOLE_DEPTH, CLAMP_HEIGHT, SPIKE = (10.0, 20.0), 30.0, 25.0, 10.0
#: The clamps' common axis lies this far beside the part's, mm: who takes the clamps for the part is wrong by as much.
CLAMP_ASIDE = 2.0


@dataclass(frozen=True)
class Truth:
    """The axis y = y0 + p x, z = z0 + q x and what else is true of the scan. Lengths in mm."""

    p: float
    q: float
    y0: float
    z0: float
    radius: float
    x_mid: float
    inner_share: float
    #: Cramér-Rao bounds with the radius free, standard deviations: the larger of deflection and pitch in degrees, and
    #: of the distance from the axis at mid scan in mm.
    bound_deg: float
    bound_mid: float


def features(scene: Scene, phi: np.ndarray, chance: np.random.Generator) -> np.ndarray:
    """How far each point (profile, direction φ) is moved away from the axis, mm."""
    clamp = clamp_offset(scene, phi, chance)
    blocks = min(BLOCKS_COUNT, scene.profiles)
    shares = {
        "screw": scene.screw_holes,
        "straight": scene.straight_holes,
        "clamp": scene.clamps,
        "tape": 0.6 * (scene.tape > 0),
    }
    kinds = [kind for kind, share in shares.items() for _ in range(round(share * blocks))]
    kinds += ["smooth"] * (blocks - len(kinds))
    rows = np.stack([block(str(kind), scene, clamp, chance) for kind in chance.permutation(kinds)])
    return rows[np.arange(scene.profiles) * blocks // scene.profiles]


def scale(scene: Scene) -> float:
    """What the features of a small part shrink by."""
    return min(1.0, scene.radius / 100.0)


def clamp_offset(scene: Scene, phi: np.ndarray, chance: np.random.Generator) -> np.ndarray:
    """Where the line of sight in direction φ meets the clamps' cylinder, beyond the part's surface, mm."""
    bearing, aside = chance.uniform(0.0, 2.0 * np.pi), CLAMP_ASIDE * scale(scene)
    radius = scene.radius + CLAMP_HEIGHT * scale(scene)
    along = aside * np.cos(phi - bearing)
    return along + np.sqrt(radius**2 - aside**2 + along**2) - scene.radius


def block(kind: str, scene: Scene, clamp: np.ndarray, chance: np.random.Generator) -> np.ndarray:
    """The offsets of one block of equal profiles."""
    places = (np.arange(scene.points) + 0.5) / scene.points
    offset = np.zeros(scene.points)

    def put(width: float, value: float | np.ndarray) -> None:
        start = chance.uniform(0.0, 1.0 - width)
        offset[:] = np.where((places >= start) & (places < start + width), value, offset)

    if kind == "screw":
        for depth in SCREW_HOLE_DEPTHS:
            put(0.02, -depth * scale(scene))
    elif kind == "straight":
        put(0.15, -STRAIGHT_HOLE_DEPTH * scale(scene))
    elif kind == "clamp":
        put(scene.clamp_arc, clamp)
    elif kind == "tape":
        put(0.5, scene.tape)
    return offset


def slopes(scene: Scene, chance: np.random.Generator) -> tuple[float, float]:
    """Deflection and pitch as slopes."""
    if scene.tilt is None:
        return tuple(np.tan(np.radians(chance.uniform(-1.5, 1.5, 2))))
    bearing = chance.uniform(0.0, 2.0 * np.pi)
    return tuple(np.tan(np.radians(scene.tilt)) * np.array([np.cos(bearing), np.sin(bearing)]))


def make(scene: Scene, seed: int) -> tuple[np.ndarray, Truth]:
    """The scan (profiles, points, xyz) in single precision, NaN where a point is missing, and its truth."""
    chance = np.random.default_rng([seed, zlib.crc32(scene.name.encode())])
    p, q = slopes(scene, chance)
    y0, z0 = chance.uniform(-10.0, 10.0, 2)
    x = np.linspace(0.0, scene.length, scene.profiles)
    # A line sensor's points stand at equal steps across its view.
    reach = np.sin(np.radians(scene.arc) / 2.0)
    phi = np.arcsin(reach * (2.0 * (np.arange(scene.points) + 0.5) / scene.points - 1.0))
    offset = features(scene, phi, chance)
    shape = offset.shape
    spiked = chance.random(shape) < scene.spikes
    offset = offset + np.where(spiked, chance.uniform(-SPIKE, SPIKE, shape), 0.0)
    along = (p * np.sin(phi) + q * np.cos(phi)) ** 2 / (1.0 + p * p + q * q)
    t = scene.radius / np.sqrt(1.0 - along) + offset
    scan = np.empty((*shape, 3), dtype=np.float32)
    scan[..., 0] = x[:, None]
    scan[..., 1] = (y0 + p * x)[:, None] + t * np.sin(phi) + chance.normal(0.0, scene.sigma, shape)
    scan[..., 2] = (z0 + q * x)[:, None] + t * np.cos(phi) + chance.normal(0.0, scene.sigma, shape)
    scan[chance.random(shape) < scene.drop_outs] = np.nan
    inner = (offset == 0.0) & ~np.isnan(scan[..., 2])
    x_mid = scene.length / 2.0
    bounds = bound(scene, (p, q), phi, x - x_mid, inner)
    return scan, Truth(p, q, y0, z0, scene.radius, x_mid, float(inner.mean()), *bounds)


def bound(
    scene: Scene, slope: tuple[float, float], phi: np.ndarray, lever: np.ndarray, inner: np.ndarray
) -> tuple[float, float]:
    """The best that anyone could know from the points on the part: the inverse of Σ J Jᵀ / σ² over (p, q, y, z, R), J
    the derivatives of a point's distance: −(u − p s)/R and −(w − q s)/R for y and z, times x + s for p and q, −1 for R.
    """
    p, q = slope
    t = scene.radius / np.sqrt(1.0 - (p * np.sin(phi) + q * np.cos(phi)) ** 2 / (1.0 + p * p + q * q))
    u, w = t * np.sin(phi), t * np.cos(phi)
    s = (p * u + q * w) / (1.0 + p * p + q * q)
    across, up = -(u - p * s) / scene.radius, -(w - q * s) / scene.radius
    information = np.zeros((5, 5))
    for x, seen in zip(lever, inner, strict=True):
        rows = np.stack([across * (x + s), up * (x + s), across, up, np.full_like(s, -1.0)])[:, seen]
        information += rows @ rows.T
    variances = np.diag(np.linalg.inv(information)) * scene.sigma**2
    angles = np.degrees(np.sqrt(variances[:2]) / (1.0 + np.square(slope)))
    return float(angles.max()), float(np.sqrt(variances[2] + variances[3]))


#: A turned cloud is moved by up to this far along each axis, mm.
MOVED = 1000.0


@dataclass(frozen=True)
class Motion:
    """The rigid motion of a turned scan."""

    rotation: np.ndarray
    origin: np.ndarray

    def of(self, points: np.ndarray) -> np.ndarray:
        """The points after it."""
        return points @ self.rotation.T + self.origin


def motion(scene: Scene, seed: int) -> Motion:
    """Any orientation is equally likely: the rotation of a random unit quaternion."""
    chance = np.random.default_rng([seed, zlib.crc32(scene.name.encode()), 2])
    w, x, y, z = (lambda q: q / np.linalg.norm(q))(chance.normal(size=4))
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return Motion(np.eye(3) + 2.0 * w * cross + 2.0 * cross @ cross, chance.uniform(-MOVED, MOVED, 3))


def turned(scan: np.ndarray, truth: Truth, by: Motion, seed: int) -> tuple[np.ndarray, dict[str, object]]:
    """The points as a cloud in no order, (points, xyz), and the truth with the axis in their coordinates."""
    points = scan[~np.isnan(scan[..., 2])].astype(np.float64)
    points = np.random.default_rng([seed, 3]).permutation(by.of(points)).astype(np.float32)
    at = [by.of(np.array([x, truth.y0 + truth.p * x, truth.z0 + truth.q * x])) for x in (0.0, truth.x_mid)]
    direction = by.rotation @ np.array([1.0, truth.p, truth.q])
    axis = {
        "origin": at[0].tolist(),
        "mid": at[1].tolist(),
        "direction": (direction / np.linalg.norm(direction)).tolist(),
    }
    return points, asdict(truth) | {"axis": axis}


def hints(scene: Scene, seed: int) -> dict[str, object]:
    """What every peer is told: the radius within 15 %, a range that holds it, the noise within 25 %, the pitch, and where
    the sensor looked from.
    """
    chance = np.random.default_rng([seed, zlib.crc32(scene.name.encode()), 1])
    radius = scene.radius * chance.uniform(0.85, 1.15)
    return {
        "radius": radius,
        "radius_min": radius / 1.2,
        "radius_max": radius * 1.2,
        "noise": scene.sigma * chance.uniform(0.75, 1.25),
        "pitch": scene.length / (scene.profiles - 1),
        "towards_sensor": (motion(scene, seed).rotation[:, 2] if scene.turned else np.array([0.0, 0.0, 1.0])).tolist(),
    }


def write_pcd(path: Path, scan: np.ndarray) -> None:
    """Binary PCD, organised: a row a profile; of a cloud one row."""
    height, width = scan.shape[:-1] if scan.ndim == 3 else (1, len(scan))
    header = (
        "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\n"
        f"WIDTH {width}\nHEIGHT {height}\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {width * height}\nDATA binary\n"
    )
    with path.open("wb") as out:
        out.write(header.encode())
        scan.tofile(out)


def main(name: str, seed: int, folder: Path) -> None:
    """Writes scan.npy, scan.pcd, truth.json and hints.json into `folder`."""
    scene = next(scene for scene in SCENES if scene.name == name)
    scan, straight = make(scene, seed)
    truth: dict[str, object] = asdict(straight)
    if scene.turned:
        scan, truth = turned(scan, straight, motion(scene, seed), seed)
    folder.mkdir(parents=True, exist_ok=True)
    np.save(folder / "scan.npy", scan)
    write_pcd(folder / "scan.pcd", scan)
    (folder / "truth.json").write_text(json.dumps(truth))
    (folder / "hints.json").write_text(json.dumps(hints(scene, seed)))


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]), Path(sys.argv[3]))
