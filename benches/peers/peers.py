"""Who is compared: the command of each, and what it is told. Must not know scenes nor scores."""

import sys
from dataclasses import dataclass, field
from pathlib import Path

HERE = Path(__file__).parent
ROOT = HERE.parent.parent


@dataclass(frozen=True)
class Peer:
    """One row of the table."""

    name: str
    #: Speaks the protocol of protocol.py; scan, hints and repeats are added behind.
    command: list[str]
    #: What the peer reads.
    scan: str = "scan.npy"
    environment: dict[str, str] = field(default_factory=dict)
    #: Whether it needs profiles along the rail, so that it cannot be asked for a cloud in no order.
    needs_profiles: bool = False
    #: What a user would call for a file instead, where that is not the same program; the scan is added behind.
    from_file: list[str] | None = None


def python(name: str, script: str, variant: str, needs_profiles: bool = False) -> Peer:
    """A peer in Python."""
    return Peer(name, [sys.executable, str(HERE / script), variant], needs_profiles=needs_profiles)


def cgal(name: str) -> Peer:
    """CGAL's shape detection."""
    return Peer(name, [str(HERE / "build/cgal_cylinder"), "efficient_ransac"], scan="scan.pcd")


def pcl(name: str, variant: str) -> Peer:
    """A variant of PCL."""
    return Peer(name, [str(HERE / "build/pcl_cylinder"), variant], scan="scan.pcd")


def engeom(name: str, variant: str) -> Peer:
    """A variant of engeom."""
    return Peer(name, [str(HERE / "engeom/target/release/engeom_peer"), variant])


def ours(name: str, method: str, needs_profiles: bool = False, **environment: str) -> Peer:
    """One of our methods; from a file it is what a user calls."""
    measure = [str(ROOT / "target/release/coaxis"), "measure", "--json", "--method", method]
    return Peer(name, [str(ROOT / "target/release/coaxis_peer"), method], environment=environment, needs_profiles=needs_profiles, from_file=measure)


#: The one that the others are compared with.
REFERENCE = "coaxis cylinder"

PEERS = [
    ours(REFERENCE, "cylinder"),
    ours("coaxis cylinder, one thread", "cylinder", RAYON_NUM_THREADS="1"),
    ours("coaxis section_line", "section_line"),
    ours("coaxis section_line_plain", "section_line_plain"),
    pcl("PCL MSAC, voxels", "voxel_msac"),
    pcl("PCL MSAC, voxels, refined again", "voxel_msac_again"),
    pcl("PCL MSAC, every n-th", "nth_msac"),
    pcl("PCL MSAC, every n-th, refined again", "nth_msac_again"),
    pcl("PCL LMedS, voxels", "voxel_lmeds"),
    engeom("engeom MAGSAC++, every n-th", "sample"),
    engeom("engeom MAGSAC++, refitted", "again"),
    cgal("CGAL Efficient RANSAC (as CloudCompare's)"),
    python("SciPy Cauchy, 50 000 points", "fit_scipy.py", "sample"),
    python("SciPy Cauchy, all points", "fit_scipy.py", "all"),
    python("OpenCV fitEllipse + line", "fit_opencv.py", "ellipse_line", needs_profiles=True),
    python("OpenCV fitEllipseAMS + line", "fit_opencv.py", "ams_line", needs_profiles=True),
    python("OpenCV fitEllipseDirect + line", "fit_opencv.py", "direct_line", needs_profiles=True),
    python("OpenCV fitEllipseDirect + robust line", "fit_opencv.py", "direct_robust", needs_profiles=True),
    python("scikit-image RANSAC ellipse + line", "fit_skimage.py", "ransac", needs_profiles=True),
    python("pyransac3d Cylinder", "fit_pyransac3d.py", "cylinder"),
]
