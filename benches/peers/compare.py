"""Every peer on every scan, in turns, one process at a time: `compare.py [--seeds N] [--scenes a,b] [--peers text]`.
Writes out/results.json, one entry a run, as it goes. Must not know how the table looks.
"""

import argparse
import json
import platform
import shutil
import subprocess
import sys
import time
from collections import Counter
from dataclasses import asdict
from pathlib import Path

from peers import HERE, PEERS, Peer
from run_peer import Run, run
from scenes import SCENES, Scene
from score import score

#: After so many time-outs on a scene a peer is not asked again there.
TIMEOUTS_MAX = 2


def entry(peer: Peer, scene: Scene, seed: int, found: Run, truth: dict[str, float]) -> dict[str, object]:
    """One run as it is kept."""
    scored = asdict(score(found.answer, truth)) if found.state == "pose" else {}
    return {"scene": scene.name, "seed": seed, "peer": peer.name, **asdict(found), **scored}


def on_scan(
    scene: Scene, seed: int, peers: list[Peer], limit_s: float, late: Counter[tuple[str, str]]
) -> list[dict[str, object]]:
    """Makes a scan, runs every peer on it, and removes it."""
    folder = HERE / "out/scan"
    subprocess.run([sys.executable, str(HERE / "make_scan.py"), scene.name, str(seed), str(folder)], check=True)
    truth = json.loads((folder / "truth.json").read_text())
    entries = []
    for peer in peers:
        if scene.turned and peer.needs_profiles:
            continue
        again = late[peer.name, scene.name] < TIMEOUTS_MAX
        found = run(peer, folder, limit_s) if again else Run("timeout", {}, None, None, None, None, None)
        late[peer.name, scene.name] += found.state == "timeout"
        entries.append(entry(peer, scene, seed, found, truth))
    shutil.rmtree(folder)
    return entries


def machine() -> dict[str, str]:
    """Where it was measured."""
    cpu = next(
        (line.split(":")[1].strip() for line in Path("/proc/cpuinfo").read_text().splitlines() if "model name" in line),
        "",
    )
    return {
        "cpu": cpu,
        "system": platform.platform(),
        "python": platform.python_version(),
        "date": time.strftime("%Y-%m-%d"),
    }


def main() -> None:
    """Reads the command line and compares."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--seeds", type=int, default=5, help="scans of each scene, with the seeds 1 to N")
    options.add_argument("--scenes", default="", help="only these, separated by commas")
    options.add_argument("--peers", default="", help="only those whose name has this in it")
    options.add_argument("--limit-s", type=float, default=60.0, help="time limit of one process")
    options.add_argument("--out", type=Path, default=HERE / "out/results.json")
    chosen = options.parse_args()
    scenes = [scene for scene in SCENES if not chosen.scenes or scene.name in chosen.scenes.split(",")]
    peers = [peer for peer in PEERS if chosen.peers in peer.name]
    chosen.out.parent.mkdir(parents=True, exist_ok=True)
    entries: list[dict[str, object]] = []
    late: Counter[tuple[str, str]] = Counter()
    for seed in range(1, chosen.seeds + 1):
        for scene in scenes:
            entries += on_scan(scene, seed, peers, chosen.limit_s, late)
            chosen.out.write_text(json.dumps({"machine": machine(), "runs": entries}, indent=1))
            print(f"seed {seed} {scene.name}", file=sys.stderr, flush=True)


if __name__ == "__main__":
    main()
