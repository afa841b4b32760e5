"""Runs every command of the README as printed, and holds its table of problem codes to the program.

Usage: readme.py COAXIS (the built command). Starts `coaxis demo` in an empty folder on a free port, then runs the `sh`
blocks of the README there in one shell, with the port put in; every curl must be answered with success.
"""

import json
import pathlib
import re
import signal
import subprocess
import sys
import tempfile

README = pathlib.Path(__file__).parent.parent / "README.md"
PRELUDE = """set -euo pipefail
curl() { command curl --fail-with-body --max-time 60 "$@"; }
"""


def check_problem_table(coaxis: str, text: str) -> None:
    begin, end = "coaxis openapi --problems` -->\n", "<!-- end of problem codes -->"
    printed = text.split(begin)[1].split(end)[0]
    table = subprocess.run([coaxis, "openapi", "--problems"], capture_output=True, text=True, check=True).stdout
    if printed != table:
        sys.exit("README: the table of problem codes is not what `coaxis openapi --problems` prints")


def run_blocks(text: str, base: str, folder: str) -> int:
    blocks = re.findall(r"^```sh\n(.*?)^```", text, re.M | re.S)
    script = PRELUDE + "\n".join(blocks).replace("http://127.0.0.1:8080", base)
    done = subprocess.run(["bash", "-c", script], cwd=folder, capture_output=True, text=True, timeout=300)
    if done.returncode != 0:
        sys.exit(f"README: a command failed\n{done.stdout[-2000:]}\n{done.stderr[-2000:]}")
    for name in ("residual_map.svg", "section.svg"):
        if "<svg" not in (pathlib.Path(folder) / name).read_text():
            sys.exit(f"README: {name} is no picture")
    if (pathlib.Path(folder) / "again.ply").read_bytes() != (pathlib.Path(folder) / "data/demo/scan.ply").read_bytes():
        sys.exit("README: the scan did not come back byte for byte")
    json.loads((pathlib.Path(folder) / "openapi.json").read_text())
    return sum(block.count("curl -s") for block in blocks)


def main() -> None:
    coaxis = str(pathlib.Path(sys.argv[1]).resolve())
    text = README.read_text()
    check_problem_table(coaxis, text)
    with tempfile.TemporaryDirectory() as folder:
        demo = subprocess.Popen(
            [coaxis, "demo", "--listen", "127.0.0.1:0"], cwd=folder, stdout=subprocess.PIPE, text=True
        )
        try:
            base = ""
            for line in demo.stdout:
                found = re.search(r"coaxis listens on (http://\S+)", line)
                base = found.group(1) if found else base
                if "Ctrl-C" in line:
                    break
            if not base:
                sys.exit("README: the demo did not say where it listens")
            count = run_blocks(text, base, folder)
        finally:
            demo.send_signal(signal.SIGTERM)
            code = demo.wait(timeout=20)
        if code != 0:
            sys.exit(f"README: the demo ended with {code}")
    print(f"README: {count} curl commands answered with success")


main()
