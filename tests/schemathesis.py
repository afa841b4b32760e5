"""Compares the running service with its OpenAPI document: starts the given binary on a free port with a temporary data folder,
runs schemathesis against it for a bounded time, and stops it.

    tests/.venv/bin/python tests/schemathesis.py target/debug/coaxis [SECONDS]
"""

import pathlib
import re
import subprocess
import sys
import tempfile
import threading

HERE = pathlib.Path(__file__).resolve().parent


def start(binary, data):
    """The service and its address, which is read from the log."""
    service = subprocess.Popen(
        [binary, "serve", "--listen", "127.0.0.1:0", "--data", data, "--set", "log.filter=warn,coaxis::cli=info"],
        stderr=subprocess.PIPE,
        text=True,
    )
    for line in service.stderr:
        found = re.search(r"listening on (http://[0-9.:]+)", line)
        if found:
            # Later lines of the log must not fill the pipe.
            threading.Thread(target=lambda: [print(line, end="", file=sys.stderr) for line in service.stderr]).start()
            return service, found.group(1)
    raise SystemExit(f"{binary} ended before it listened")


def main():
    binary = sys.argv[1]
    seconds = sys.argv[2] if len(sys.argv) > 2 else "150"
    with tempfile.TemporaryDirectory() as data:
        service, address = start(binary, data)
        try:
            code = subprocess.call(
                [
                    pathlib.Path(sys.executable).parent / "schemathesis",
                    "--config-file",
                    HERE / "schemathesis.toml",
                    "run",
                    f"{address}/openapi.json",
                    "--checks=all",
                    "--seed=1",
                    f"--max-time={seconds}",
                    "--suppress-health-check=all",
                    "--continue-on-failure",
                ],
                cwd=data,
            )
        finally:
            service.terminate()
            if service.wait(timeout=20) != 0:
                raise SystemExit("the service did not end with exit code 0")
    raise SystemExit(code)


main()
