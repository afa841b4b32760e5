"""From out/results.json to Markdown: `table.py [results.json]`. Must not know how anything was measured."""

import json
import math
import sys
from collections.abc import Callable
from pathlib import Path
from statistics import median

from peers import HERE, PEERS, REFERENCE
from scenes import SCENES

Run = dict[str, object]
#: Scenes that are no part of the medians over scenes, being of another size.
APART = {"huge"}


class Results:
    """The runs by scene and peer, in the order of the lists."""

    def __init__(self, runs: list[Run]) -> None:
        self.runs = runs
        self.scenes = [scene.name for scene in SCENES if any(run["scene"] == scene.name for run in runs)]
        self.peers = [peer.name for peer in PEERS if any(run["peer"] == peer.name for run in runs)]
        self.letters = dict(zip(self.peers, "ABCDEFGHIJKLMNOPQRSTUVWXYZ"))

    def of(self, peer: str, scene: str | None = None) -> list[Run]:
        """One peer's runs on a scene, or on all of the usual size."""
        there = {scene} if scene else set(self.scenes) - APART
        return [run for run in self.runs if run["peer"] == peer and run["scene"] in there]

    def middle(self, name: str, peer: str, scene: str | None = None) -> float:
        """Median of a number over the runs that have it; NaN where none has."""
        values = [run[name] for run in self.of(peer, scene) if run.get(name) is not None]
        return median(values) if values else math.nan

    def ratio(self, name: str, peer: str, scene: str) -> float:
        """Median over the scans of a peer's number over the reference's on the same scan."""
        ours = {run["seed"]: run[name] for run in self.of(REFERENCE, scene)}
        pairs = [(run[name], ours.get(run["seed"])) for run in self.of(peer, scene)]
        ratios = [theirs / our for theirs, our in pairs if theirs is not None and our]
        return median(ratios) if ratios else math.nan


def right(runs: list[Run]) -> int:
    """How many poses are right."""
    return sum(bool(run.get("success")) for run in runs)


def number(value: float, digits: int = 2) -> str:
    """A number with so many significant digits, or a dash."""
    if math.isnan(value):
        return "–"
    places = max(0, digits - 1 - math.floor(math.log10(abs(value)))) if value else 0
    return f"{round(value, digits - 1 - math.floor(math.log10(abs(value)))) if value else 0:.{places}f}"


def rows(header: list[str], lines: list[list[str]]) -> str:
    """A Markdown table."""
    return "\n".join(f"| {' | '.join(line)} |" for line in [header, ["---"] * len(header), *lines])


def summary(results: Results) -> str:
    """A row a peer: over all scenes of the usual size."""
    header = ["", "peer", "right", "wrong", "refused", "late", "angle °", "mid scan mm", "ms", "× ours", "from file ms", "CPU ms", "MB"]
    if any(scene in APART for scene in results.scenes):
        header += ["huge ms", "huge MB"]
    lines = []
    for peer in results.peers:
        runs = results.of(peer)
        states = [run["state"] for run in runs]
        wrong = states.count("pose") - right(runs)
        usual = [scene for scene in results.scenes if scene not in APART]
        ratios = [ratio for scene in usual if not math.isnan(ratio := results.ratio("seconds", peer, scene))]
        line = [results.letters[peer], peer, f"{right(runs)}/{len(runs)}", str(wrong), str(states.count("refused"))]
        line += [str(states.count("timeout") + states.count("failed"))]
        line += [number(results.middle("angle_deg", peer)), number(results.middle("mid_mm", peer))]
        line += [number(results.middle("seconds", peer) * 1e3), number(median(ratios) if ratios else math.nan)]
        line += [number(results.middle(name, peer) * 1e3) for name in ("process_seconds", "process_cpu_seconds")]
        line += [number(results.middle("peak_mb", peer))]
        if len(header) > 13:
            line += [number(results.middle("seconds", peer, "huge") * 1e3), number(results.middle("peak_mb", peer, "huge"))]
        lines.append(line)
    return rows(header, lines)


def matrix(results: Results, cell: Callable[[str, str], str]) -> str:
    """A row a scene, a column a peer."""
    lines = [[scene, *(cell(peer, scene) for peer in results.peers)] for scene in results.scenes]
    return rows(["scene", *results.letters.values()], lines)


def right_cell(results: Results, peer: str, scene: str) -> str:
    """Right of all, and how many were refused."""
    runs = results.of(peer, scene)
    states = [run["state"] for run in runs]
    marks = {"refused": "r", "timeout": "t", "failed": "f"}
    said = "".join(f" {states.count(state)}{mark}" for state, mark in marks.items() if state in states)
    return f"{right(runs)}/{len(runs)}{said}" if runs else "–"


def wins(results: Results) -> str:
    """Cells in which a peer is more often right than the reference, nearer, or faster."""
    found = []
    for scene in results.scenes:
        ours = results.of(REFERENCE, scene)
        for peer in results.peers:
            runs = results.of(peer, scene)
            if peer.startswith("coaxis") or not runs:
                continue
            if right(runs) * len(ours) > right(ours) * len(runs):
                found.append(f"- {scene}: {peer} is right {right(runs)} of {len(runs)} times, ours {right(ours)} of {len(ours)}")
            if right(runs) == 0:
                continue
            for name, word in [("angle_deg", "angle"), ("mid_mm", "position"), ("seconds", "time")]:
                theirs, our = results.middle(name, peer, scene), results.middle(name, REFERENCE, scene)
                if theirs < our:
                    found.append(f"- {scene}: {peer}, median {word} {number(theirs / our, 3)} of ours")
    return "\n".join(found) or "none"


def main(path: Path) -> None:
    """Prints everything."""
    kept = json.loads(path.read_text())
    results = Results(kept["runs"])
    per_scene = lambda name, factor=1.0: matrix(results, lambda p, s: number(results.middle(name, p, s) * factor))  # noqa: E731
    parts = [
        ("Over all scenes", summary(results)),
        ("Right (r refused, t too late, f failed)", matrix(results, lambda p, s: right_cell(results, p, s))),
        ("Angle error, median, thousandths of a degree", per_scene("angle_deg", 1e3)),
        ("Position error at mid scan, median, µm", per_scene("mid_mm", 1e3)),
        ("Estimation, median, ms", per_scene("seconds", 1e3)),
        ("Estimation, ratio to ours", matrix(results, lambda p, s: number(results.ratio("seconds", p, s)))),
        ("Whole process from the file, median, ms", per_scene("process_seconds", 1e3)),
        ("Peak memory, median, MB", per_scene("peak_mb")),
        ("Cells that a peer wins", wins(results)),
    ]
    print("Machine:", ", ".join(kept["machine"].values()), "\n")
    for title, text in parts:
        print(f"## {title}\n\n{text}\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else HERE / "out/results.json")
