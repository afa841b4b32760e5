"""From out/results.json to Markdown: `table.py [--into FILE]` prints every table, or puts the main ones into FILE,
between the two comments that name this script there. Must not know how anything was measured.
"""

import argparse
import json
import math
import re
from collections.abc import Callable
from functools import partial
from pathlib import Path
from statistics import median
from string import ascii_uppercase
from typing import Any

from peers import HERE, PEERS, REFERENCE
from scenes import SCENES

Run = dict[str, Any]
#: The errors, and their bounds.
ERRORS = [("angle_deg", "bound_deg"), ("mid_mm", "bound_mid_mm")]
#: RMS of five errors, in bounds, that chance alone gives one time in twenty or less: a smaller error is then luck.
AT_THE_BOUND = 1.5
#: Scenes that are no part of the medians over scenes, being of another size.
APART = {"huge"}


class Results:
    """The runs by scene and peer, in the order of the lists."""

    def __init__(self, runs: list[Run]) -> None:
        self.runs = runs
        self.scenes = [scene.name for scene in SCENES if any(run["scene"] == scene.name for run in runs)]
        self.peers = [peer.name for peer in PEERS if any(run["peer"] == peer.name for run in runs)]
        self.letters = dict(zip(self.peers, ascii_uppercase, strict=False))

    def of(self, peer: str, scene: str | None = None) -> list[Run]:
        """One peer's runs on a scene, or on all of the usual size."""
        there = {scene} if scene else set(self.scenes) - APART
        return [run for run in self.runs if run["peer"] == peer and run["scene"] in there]

    def middle(self, name: str, peer: str, scene: str | None = None) -> float:
        """Median of a number over the runs that have it; NaN where none has."""
        values = [run[name] for run in self.of(peer, scene) if run.get(name) is not None]
        return median(values) if values else math.nan

    def in_bounds(self, error: str, bound: str, peer: str, scene: str | None = None) -> float:
        """RMS over the right poses of an error over its Cramér-Rao bound; NaN where none is right."""
        squares = [(run[error] / run[bound]) ** 2 for run in self.of(peer, scene) if run.get("success")]
        return math.sqrt(sum(squares) / len(squares)) if squares else math.nan

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
    header = ["", "peer", "right", "wrong", "refused", "late", "angle °", "in bounds", "mid scan mm", "in bounds"]
    header += ["ms", "× ours", "from file ms", "CPU ms", "MB"]
    huge = any(scene in APART for scene in results.scenes)
    header += ["huge ms", "huge MB"] if huge else []
    lines = []
    for peer in results.peers:
        runs = results.of(peer)
        states = [run["state"] for run in runs]
        wrong = states.count("pose") - right(runs)
        usual = [scene for scene in results.scenes if scene not in APART]
        ratios = [ratio for scene in usual if not math.isnan(ratio := results.ratio("seconds", peer, scene))]
        line = [results.letters[peer], peer, f"{right(runs)}/{len(runs)}", str(wrong), str(states.count("refused"))]
        line += [str(states.count("timeout") + states.count("failed"))]
        for error, bound in ERRORS:
            line += [number(results.middle(error, peer)), number(results.in_bounds(error, bound, peer))]
        line += [number(results.middle("seconds", peer) * 1e3), number(median(ratios) if ratios else math.nan)]
        line += [number(results.middle(name, peer) * 1e3) for name in ("process_seconds", "process_cpu_seconds")]
        line += [number(results.middle("peak_mb", peer))]
        if huge:
            line += [
                number(results.middle("seconds", peer, "huge") * 1e3),
                number(results.middle("peak_mb", peer, "huge")),
            ]
        lines.append(line)
    return rows(header, lines)


def matrix(
    results: Results, cell: Callable[[str, str], str], first: tuple[str, Callable[[str], str]] | None = None
) -> str:
    """A row a scene, a column a peer, and before them one more."""
    title, value = ([first[0]], lambda scene: [first[1](scene)]) if first else ([], lambda _: [])
    lines = [[scene, *value(scene), *(cell(peer, scene) for peer in results.peers)] for scene in results.scenes]
    return rows(["scene", *title, *results.letters.values()], lines)


def right_cell(results: Results, peer: str, scene: str) -> str:
    """Right of all, and how many were refused."""
    runs = results.of(peer, scene)
    states = [run["state"] for run in runs]
    marks = {"refused": "r", "timeout": "t", "failed": "f"}
    said = "".join(f" {states.count(state)}{mark}" for state, mark in marks.items() if state in states)
    return f"{right(runs)}/{len(runs)}{said}" if runs else "–"


def wins(results: Results) -> str:
    """Cells in which a peer is more often right than the reference, nearer (unless ours is at the bound), or faster."""
    found = []
    for scene in results.scenes:
        ours = results.of(REFERENCE, scene)
        for peer in results.peers:
            runs = results.of(peer, scene)
            if peer.startswith("coaxis") or not runs:
                continue
            if right(runs) * len(ours) > right(ours) * len(runs):
                found.append(
                    f"- {scene}: {peer} is right {right(runs)} of {len(runs)} times, ours {right(ours)} of {len(ours)}"
                )
            if right(runs) == 0:
                continue
            for error, bound in ERRORS:
                theirs, our = (results.in_bounds(error, bound, name, scene) for name in (peer, REFERENCE))
                if theirs < our and our > AT_THE_BOUND:
                    found.append(f"- {scene}: {peer}, {error} of {number(theirs)} bounds (RMS), ours {number(our)}")
            ratio = results.ratio("seconds", peer, scene)
            if ratio < 1.0:
                found.append(f"- {scene}: {peer} takes {number(ratio)} of our time, right {right(runs)} of {len(runs)}")
    return "\n".join(found) or "none"


def tables(results: Results) -> dict[str, str]:
    """Every table by its title, the main ones first."""

    def per_scene(name: str, factor: float, bound: str = "") -> str:
        first = ("bound", lambda scene: number(results.middle(bound, REFERENCE, scene) * factor)) if bound else None
        return matrix(results, lambda peer, scene: number(results.middle(name, peer, scene) * factor), first)

    def ratio(peer: str, scene: str) -> str:
        return number(results.ratio("seconds", peer, scene))

    return {
        "Over all scenes": summary(results),
        "Right, of all (r refused, t too late, f failed)": matrix(results, partial(right_cell, results)),
        "Position error at mid scan, median, µm": per_scene("mid_mm", 1e3, "bound_mid_mm"),
        "Angle error, median, thousandths of a degree": per_scene("angle_deg", 1e3, "bound_deg"),
        "Time of the estimation, ratio to ours": matrix(results, ratio),
        "Where a peer wins": wins(results),
        "Estimation, median, ms": per_scene("seconds", 1e3),
        "Whole process from the file, median, ms": per_scene("process_seconds", 1e3),
        "Peak memory, median, MB": per_scene("peak_mb", 1.0),
    }


#: So many of the tables are the main ones.
MAIN_COUNT = 6


def put_into(path: Path, text: str) -> None:
    """Replaces what stands between the two comments."""
    begin, end = "<!-- benches/peers/table.py: begin -->", "<!-- benches/peers/table.py: end -->"
    page = path.read_text()
    if begin not in page or end not in page:
        raise SystemExit(f"{path}: no place between {begin} and {end}")
    between = re.compile(f"{re.escape(begin)}.*?{re.escape(end)}", re.DOTALL)
    path.write_text(between.sub(lambda _: f"{begin}\n{text}\n{end}", page))


def main() -> None:
    """Reads the command line, and prints or puts."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("results", nargs="?", type=Path, default=HERE / "out/results.json")
    options.add_argument("--into", type=Path)
    chosen = options.parse_args()
    kept = json.loads(chosen.results.read_text())
    found = list(tables(Results(kept["runs"])).items())
    shown = found[:MAIN_COUNT] if chosen.into else found
    text = "\n\n".join(
        [f"Machine: {', '.join(kept['machine'].values())}", *(f"**{title}**\n\n{body}" for title, body in shown)]
    )
    if chosen.into:
        put_into(chosen.into, text)
    else:
        print(text)


if __name__ == "__main__":
    main()
