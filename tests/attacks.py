"""Attacks on the listener of the service: measures whether stops are answered during each attack.

Usage: attacks.py COAXIS (the built command) [STOPS]. Starts `coaxis serve` with a simulated cell on a free port and a folder
in memory. During each attack it sends stops (1000 by default), each over a new connection, and prints their durations. It fails
if a stop is lost, or if the 99th percentile is above 50 ms. Then 16 scans that need much memory are sent at once, to a service
with 4096 and one with 1024 MiB for points; it fails if the process needs more. The figures are in docs/reliability.md.

The attackers run in a separate process and reopen the connections that the service closes, up to 500 a second.
"""

import gzip
import io
import multiprocessing
import pathlib
import random
import re
import select
import socket
import statistics
import struct
import subprocess
import sys
import tempfile
import threading
import time
import zipfile

STOP_P99_MS_MAX = 50
# Memory of the process beside its points: 64 MiB by docs/benchmarks.md.
BESIDE_MIB = 64
OPENED_PER_S_MAX = 500
PATIENCE_S = 5
LENGTH = 1_000_000


def start(binary, data, *settings):
    """The service and its port, which is read from the log."""
    command = [binary, "serve", "--listen", "127.0.0.1:0", "--data", data]
    for setting in ("log.filter=error,coaxis::cli=info", *settings):
        command += ["--set", setting]
    service = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    for line in service.stderr:
        found = re.search(r"listening on http://127.0.0.1:([0-9]+)", line)
        if found:
            threading.Thread(target=lambda: [print(line, end="", file=sys.stderr) for line in service.stderr]).start()
            return service, int(found.group(1))
    raise SystemExit(f"{binary} ended before it listened")


def ask(port, head, body=b"", source="127.0.0.1", patience_s=PATIENCE_S):
    """One request over a new connection: the status (0 if there was no answer) and the answer."""
    try:
        with socket.create_connection(("127.0.0.1", port), patience_s, (source, 0)) as connection:
            lines = f"{head} HTTP/1.1\r\nHost: localhost\r\nContent-Length: {len(body)}\r\nConnection: close\r\n\r\n"
            connection.sendall(lines.encode() + body)
            answer = b""
            while piece := connection.recv(65536):
                answer += piece
            return int(answer.split(b" ", 2)[1]) if answer.startswith(b"HTTP/1.1 ") else 0, answer
    except OSError:
        return 0, b""


class Attack:
    """Connections that are kept open; each sends `feed` at once and `trickle` every `pause` seconds."""

    def __init__(self, port, count, feed, trickle=b"", pause=1.0):
        self.arguments = (port, count, feed, trickle, pause)

    def __enter__(self):
        self.ready = multiprocessing.Event()
        self.process = multiprocessing.Process(target=self.run, daemon=True)
        self.process.start()
        self.ready.wait(30)
        return self

    def __exit__(self, *_):
        self.process.kill()
        self.process.join()

    def run(self):
        port, count, feed, trickle, pause = self.arguments
        poll, connections, due = select.poll(), {}, time.monotonic() + pause
        begun, opened = time.monotonic(), -count
        while True:
            while len(connections) < count and opened < (time.monotonic() - begun) * OPENED_PER_S_MAX:
                opened += 1
                connection = socket.socket()
                try:
                    connection.settimeout(1)
                    connection.connect(("127.0.0.1", port))
                    connection.setblocking(False)
                    connection.send(feed)
                except OSError:
                    connection.close()
                    break
                connections[connection.fileno()] = connection
                # Answers are not read; only the end of the connection is detected.
                poll.register(connection, select.POLLRDHUP)
            self.ready.set()
            for number, _ in poll.poll(10):
                poll.unregister(number)
                connections.pop(number).close()
            if trickle and time.monotonic() >= due:
                due += pause
                for connection in connections.values():
                    try:
                        connection.send(trickle)
                    except OSError:
                        pass


def stops(port, count):
    """Sends `count` stops: their durations in ms, and the number without an answer."""
    times, lost = [], 0
    for _ in range(count):
        begun = time.perf_counter()
        status, _ = ask(port, "POST /v1/cell/stop")
        if status == 200:
            times.append((time.perf_counter() - begun) * 1e3)
        else:
            lost += 1
        time.sleep(0.005)
    return sorted(times), lost


def measure(name, port, count):
    times, lost = stops(port, count)
    if not times:
        print(f"{name:<44}{'no stop was answered':>32}")
        return False
    p99 = times[min(len(times) - 1, int(len(times) * 0.99))]
    kept = lost == 0 and p99 <= STOP_P99_MS_MAX
    print(
        f"{name:<44}{len(times):>8}{lost:>8}{statistics.median(times):>10.1f}{p99:>10.1f}{times[-1]:>10.1f}"
        f"{'' if kept else '   GOAL MISSED'}",
        flush=True,
    )
    return kept


def others_upload(port):
    """Whether uploads of another address are accepted, and how long those of the address of the attacker are refused, in s."""
    scan = b"".join(b"%d,%d,%d\n" % (x, y, 200 - y * y // 400) for x in range(20) for y in range(-50, 51, 5))
    other, _ = ask(port, "POST /v1/scans", scan, "127.0.0.2")
    begun = time.monotonic()
    while time.monotonic() < begun + 130:
        if ask(port, "POST /v1/scans", scan)[0] in (200, 201):
            break
        time.sleep(0.25)
    return other in (200, 201), time.monotonic() - begun


def npy(kind, shape, numbers):
    header = f"{{'descr': '{kind}', 'fortran_order': False, 'shape': {shape}, }}".ljust(117) + "\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header.encode() + numbers


def hungry_scans():
    """Scans that need much memory for their length, with the query that reads them."""
    count, chance = 3_000_000, random.Random(5)
    places = [(chance.randrange(5000), chance.uniform(-50, 50)) for _ in range(count)]
    points = b"".join(struct.pack("<3d", x, y, 300 - y * y / 400) for x, y in places)
    unordered = npy("<f8", (count, 3), points)
    archive = io.BytesIO()
    with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as packed:
        packed.writestr("scan.npy", unordered)
    table = b"".join(b"%d,%.2f,%.2f\n" % (x, y, 300 - y * y / 400) for x, y in places)
    heights = npy("<f2", (8000, 1000), struct.pack("<e", 42.0) * 8_000_000)
    return [
        ("", unordered),
        ("?format=npz", archive.getvalue()),
        ("?format=csv", gzip.compress(table, 1)),
        ("?format=npy&x_pitch_mm=1&y_pitch_mm=0.1", heights),
    ]


def peak_mib(service):
    status = pathlib.Path(f"/proc/{service.pid}/status").read_text()
    return int(re.search(r"VmHWM:\s+([0-9]+) kB", status).group(1)) / 1024


def measure_memory(binary, scans, most_mib):
    """Sends every scan four times, all at once: whether all were answered and the process stayed within its memory."""
    with tempfile.TemporaryDirectory(dir="/dev/shm") as data:
        settings = (f"limits.memory_max_mb={most_mib}", "limits.measurements_running_max=8", "limits.peer_share_percent=100")
        service, port = start(binary, data, *settings)
        answers, begun = [], time.monotonic()
        try:

            def send(query, body):
                answers.append(ask(port, f"POST /v1/measurements{query}", body, patience_s=300))

            threads = [threading.Thread(target=send, args=scan) for scan in scans * 4]
            for thread in threads:
                thread.start()
            for thread in threads:
                thread.join()
            peak, took_s = peak_mib(service), time.monotonic() - begun
        finally:
            service.terminate()
            service.wait(timeout=20)
    answered = sum(status in (200, 201) for status, _ in answers)
    # A scan with more points than the memory admits is refused by name, and nothing else may happen to it.
    too_large = sum(status == 413 and b'"too_many_points"' in answer for status, answer in answers)
    kept = peak <= most_mib + BESIDE_MIB and answered + too_large == len(answers) and answered >= 3 * len(scans)
    missed = "" if kept else "   GOAL MISSED"
    print(f"16 scans at once, {most_mib} MiB: {answered} answered, {too_large} refused as too large, in {took_s:.0f} s, {peak:.0f} MiB at most{missed}")
    return kept


def main():
    binary = pathlib.Path(sys.argv[1]).resolve()
    count = int(sys.argv[2]) if len(sys.argv) > 2 else 1000
    with tempfile.TemporaryDirectory(dir="/dev/shm") as data:
        service, port = start(binary, data)
        kept = []
        try:
            body = b"".join(b"%d,%d,%d\n" % (x, y, 200) for x in range(1000) for y in range(-250, 251))
            _, answer = ask(port, "POST /v1/scans", body, patience_s=60)
            scan = re.search(rb"s-[0-9a-f]{64}", answer).group().decode()
            large = f"GET /v1/scans/{scan}/content HTTP/1.1\r\nHost: localhost\r\n\r\n".encode() * 20
            upload = f"POST /v1/scans HTTP/1.1\r\nHost: localhost\r\nContent-Length: {LENGTH}\r\n\r\n1,2,3\n".encode()
            print(f"{'ms':<44}{'stops':>8}{'lost':>8}{'median':>10}{'99 %':>10}{'maximum':>10}")
            kept.append(measure("no attack", port, count))
            attacks = [
                ("530 sockets that never read", Attack(port, 530, large)),
                ("530 sockets that send nothing", Attack(port, 530, b"")),
                ("530 sockets with incomplete header lines", Attack(port, 530, b"GET /v1/status HTTP/1.1\r\nHost: loc", b"a")),
                ("512 slow bodies", Attack(port, 512, upload, b"1", 1.0)),
                ("64 slow uploads", Attack(port, 64, upload, b"1", 5.0)),
            ]
            for name, attack in attacks:
                with attack:
                    kept.append(measure(name, port, count))
            with Attack(port, 200, upload, b"1", 5.0):
                taken, refused_s = others_upload(port)
            print(f"200 slow uploads: those of another address are {'accepted' if taken else 'NOT ACCEPTED'}, those of the")
            print(f"same address during the attack after {refused_s:.0f} s")
            kept.append(taken)
        finally:
            service.terminate()
            kept.append(service.wait(timeout=20) == 0)
    scans = hungry_scans()
    kept += [measure_memory(binary, scans, most_mib) for most_mib in (4096, 1024)]
    raise SystemExit(0 if all(kept) else "a stop or another client was blocked by an attack, or the memory was exceeded")


if __name__ == "__main__":
    main()
