"""One peer on one scan: what it answered, how long it took, how much memory. Must not know scenes nor tables.

GNU time stands between: what the kernel says of a process's peak memory includes what its parent held when it began.
"""

import json
import os
import select
import signal
import time
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from tempfile import NamedTemporaryFile, TemporaryFile
from typing import Any

from peers import Peer

#: An estimation that took less is repeated, and the median counts.
REPEAT_BELOW_S, REPEATS = 1.0, 5


@dataclass(frozen=True)
class Run:
    """What is known of one run."""

    state: str  # "pose", "refused", "timeout" or "failed"
    answer: dict[str, Any]
    #: From points in memory to the pose: the median of the repeats, and the first time.
    seconds: float | None
    first_seconds: float | None
    #: From the file to the answer, whole process.
    process_seconds: float | None
    process_cpu_seconds: float | None
    peak_mb: float | None


@dataclass(frozen=True)
class Ended:
    """What is left of a process."""

    text: str
    code: int
    seconds: float
    cpu_seconds: float
    peak_mb: float
    timed_out: bool


def execute(command: list[str], environment: dict[str, str], limit_s: float) -> Ended:
    """Runs a process by itself and counts what it used."""
    with TemporaryFile() as out, open(os.devnull, "wb") as nothing, NamedTemporaryFile() as used:
        counted = ["/usr/bin/time", "--quiet", "--format", "%U %S %M", "--output", used.name, *command]
        start = time.perf_counter()
        actions = [(os.POSIX_SPAWN_DUP2, out.fileno(), 1), (os.POSIX_SPAWN_DUP2, nothing.fileno(), 2)]
        child = os.posix_spawn(counted[0], counted, {**os.environ, **environment}, file_actions=actions, setpgroup=0)
        timed_out = not exited_within(child, limit_s)
        seconds = time.perf_counter() - start
        if timed_out:
            os.killpg(child, signal.SIGKILL)
        _, status = os.waitpid(child, 0)
        out.seek(0)
        text = out.read().decode(errors="replace")
        user, system, peak_kb = (used.read().split() or [b"nan"] * 3)[-3:]
    cpu_seconds, peak_mb = float(user) + float(system), float(peak_kb) / 1024.0
    return Ended(text, os.waitstatus_to_exitcode(status), seconds, cpu_seconds, peak_mb, timed_out)


def exited_within(child: int, limit_s: float) -> bool:
    """Waits for a child without collecting it."""
    descriptor = os.pidfd_open(child)
    try:
        return bool(select.select([descriptor], [], [], limit_s)[0])
    finally:
        os.close(descriptor)


def run(peer: Peer, folder: Path, limit_s: float) -> Run:
    """The process once, from the file; where it was quick, once more with repeats for the estimation proper."""
    files = [str(folder / peer.scan), str(folder / "hints.json")]
    whole = execute([*peer.command, *files], peer.environment, limit_s)
    if whole.timed_out or whole.code != 0:
        return Run("timeout" if whole.timed_out else "failed", {}, None, None, None, None, None)
    answer = json.loads(whole.text)
    first = answer.pop("seconds")[0]
    seconds = first
    if first < REPEAT_BELOW_S:
        again = execute([*peer.command, *files, str(REPEATS)], peer.environment, limit_s)
        seconds = median(json.loads(again.text)["seconds"])
    if peer.from_file is not None:
        whole = execute([*peer.from_file, files[0]], peer.environment, limit_s)
    state = "refused" if "refused" in answer else "pose"
    return Run(state, answer, seconds, first, whole.seconds, whole.cpu_seconds, whole.peak_mb)
