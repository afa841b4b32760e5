"""The scenes of the comparison: what is scanned, in numbers. Must not know how a scan is made nor who measures it."""

from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Scene:
    """A part and what lies on it. Lengths in mm, angles in degrees; shares are of profiles if nothing else is said."""

    name: str
    note: str
    radius: float = 200.0
    sigma: float = 0.05
    profiles: int = 400
    points: int = 640
    arc: float = 120.0
    length: float = 800.0
    #: Angle between the axis and the rail; None draws deflection and pitch from ±1.5° each.
    tilt: float | None = None
    screw_holes: float = 0.0
    straight_holes: float = 0.0
    clamps: float = 0.0
    #: Share of the arc that a clamp covers.
    clamp_arc: float = 0.5
    #: Thickness of a tape over half of the arc, on 60 % of the profiles.
    tape: float = 0.0
    #: Share of the points that are missing, and that are thrown off by up to 10 mm.
    drop_outs: float = 0.0
    spikes: float = 0.0
    #: Whether the points are a cloud in no order, turned to a random orientation and moved by up to 1 m along each axis.
    turned: bool = False


PAPER: dict[str, Any] = {"screw_holes": 0.20, "straight_holes": 0.16, "clamps": 0.24}


def paper(name: str, note: str, **what: Any) -> Scene:
    """The published mix (40 % smooth profiles) with one thing made harder."""
    return Scene(name, f"paper, {note}", **(PAPER | what))


SCENES = [
    Scene("clean", "nothing but the part"),
    Scene("holes", "40 % screw holes, 30 % straight holes", screw_holes=0.40, straight_holes=0.30),
    Scene("paper", "20 % screw holes, 16 % straight holes, 24 % clamps over half the arc", **PAPER),
    Scene("hard", "50 % clamps, 16 + 14 % holes, 20 % smooth", clamps=0.50, screw_holes=0.16, straight_holes=0.14),
    Scene("no_smooth", "50 % clamps, 26 + 24 % holes, none smooth", clamps=0.50, screw_holes=0.26, straight_holes=0.24),
    Scene("clamps_50", "clamps over 50 % of the arc on 90 % of the profiles", clamps=0.90, clamp_arc=0.50),
    Scene("clamps_70", "clamps over 70 % of the arc on 86 % of the profiles", clamps=0.86, clamp_arc=0.70),
    Scene("clamps_85", "clamps over 85 % of the arc on 84 % of the profiles", clamps=0.84, clamp_arc=0.85),
    paper("drop_outs", "30 % of the points missing, 5 % spikes", drop_outs=0.30, spikes=0.05),
    paper("noise_0.2", "σ = 0.2 mm", sigma=0.2),
    paper("sparse", "40 profiles, 20 mm apart", profiles=40),
    paper("length_50", "50 mm long", length=50.0),
    paper("arc_90", "90° seen", arc=90.0),
    paper("arc_60", "60° seen", arc=60.0),
    paper("radius_20", "R = 20 mm", radius=20.0),
    paper("radius_50", "R = 50 mm", radius=50.0),
    paper("radius_1000", "R = 1000 mm", radius=1000.0),
    paper("tilt_10", "axis 10° off the rail", tilt=10.0),
    Scene("tape_0.4", "tape of 0.4 mm over half the arc on 60 % of the profiles", tape=0.4),
    Scene("tape_1.5", "tape of 1.5 mm over half the arc on 60 % of the profiles", tape=1.5),
    Scene("turned", "nothing but the part, in any orientation", turned=True),
    paper("turned_paper", "in any orientation", turned=True),
    Scene("turned_clamps_50", "clamps_50, in any orientation", clamps=0.90, clamp_arc=0.50, turned=True),
    paper("turned_noise_0.2", "σ = 0.2 mm, in any orientation", sigma=0.2, turned=True),
    paper("turned_arc_90", "90° seen, in any orientation", arc=90.0, turned=True),
    paper("turned_radius_20", "R = 20 mm, in any orientation", radius=20.0, turned=True),
    paper("huge", "5000 × 1280 points", profiles=5000, points=1280),
]
