"""Runs every command of the README and of docs/ as printed, and checks other statements of the documents about the program.

Usage: readme.py COAXIS [PAGE ...] (the built command; with pages, those are run and nothing else is checked). Each page with `sh`
blocks gets its own folder and its own `coaxis demo` on a free port. Its blocks run there one after the other in one shell, with
free ports put in: in `sh` every curl must be answered with success, in `sh refused` with a 4xx or 5xx. An `output` block
right below contains the expected output. `console` blocks are not run.
"""

import json
import pathlib
import re
import signal
import socket
import subprocess
import sys
import tempfile
import typing
import urllib.parse

ROOT = pathlib.Path(__file__).resolve().parent.parent
README = ROOT / "README.md"
README_LINES_MAX = 150
PROBLEMS = ROOT / "docs" / "problems.md"
PAGES = [README, *sorted((ROOT / "docs").glob("*.md"))]
LINKING = [
    *PAGES,
    *sorted((ROOT / "docs" / "decisions").glob("*.md")),
    *sorted((ROOT / "examples").glob("*/README.md")),
    ROOT / "CONTRIBUTING.md",
    ROOT / "SECURITY.md",
]

# The address of the service in the pages, and the addresses of further programs.
SERVICE = "http://127.0.0.1:8080"
FURTHER = ("127.0.0.1:8081", "127.0.0.1:1502")
# Printed after every block.
END = "<<< end of a block >>>"

PRELUDE = """set -euo pipefail
trap 'kill $(jobs -p) 2>/dev/null || true' EXIT
# Exit code 22 of curl is an answer of 400 or above.
curl() { local code=0; command curl --fail-with-body --max-time 60 "$@" || code=$?; [ "$code" -eq "$curl_code" ]; }
"""


def fail(page: pathlib.Path, reason: str) -> None:
    sys.exit(f"{page.relative_to(ROOT)}: {reason}")


def check_problem_table(coaxis: str) -> None:
    begin, end = "coaxis openapi --problems` -->\n", "<!-- end of problem codes -->"
    printed = PROBLEMS.read_text().split(begin)[1].split(end)[0]
    table = subprocess.run([coaxis, "openapi", "--problems"], capture_output=True, text=True, check=True).stdout
    if printed != table:
        fail(PROBLEMS, "the table of problem codes differs from the output of `coaxis openapi --problems`")


def without_blocks(page: pathlib.Path) -> str:
    return re.sub(r"^```.*?^```", "", page.read_text(), flags=re.M | re.S)


def anchors(page: pathlib.Path) -> set[str]:
    """The anchors that GitHub gives to the headings of a page, and those that the page states itself."""
    text = without_blocks(page)
    headings = re.findall(r"^#+ (.*)$", text, re.M)
    named = {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}
    return named | set(re.findall(r'<a id="([^"]+)">', text))


def check_links(page: pathlib.Path) -> None:
    for target in re.findall(r"\]\(([^)\s]+)\)", without_blocks(page)):
        if urllib.parse.urlparse(target).scheme:
            continue
        path, _, anchor = target.partition("#")
        linked = (page.parent / path).resolve() if path else page
        if not linked.exists():
            fail(page, f"the link {target} leads nowhere")
        if anchor and anchor not in anchors(linked):
            fail(page, f"the link {target} names a heading that does not exist in {linked.name}")


class Block(typing.NamedTuple):
    """A block that is run, with the `output` block that follows it, if there is one."""

    must_be_refused: bool
    text: str
    output: str


def blocks(page: pathlib.Path) -> list[Block]:
    pattern = r"^```sh( refused)?\n(.*?)^```\n(?:\n```output\n(.*?)^```\n)?"
    found = re.findall(pattern, page.read_text(), re.M | re.S)
    return [Block(bool(refused), text, output) for refused, text, output in found]


def check_output(page: pathlib.Path, block: Block, printed: str) -> None:
    """Each line of `output` must have been printed, in this order; `…` stands for anything."""
    lines = iter(printed.splitlines())
    for expected in block.output.splitlines():
        pattern = ".*".join(re.escape(part) for part in expected.strip().split("…"))
        if not any(re.fullmatch(pattern, line.strip()) for line in lines):
            fail(page, f"this was not printed: {expected}\nby\n{block.text}\nbut\n{printed[:4000]}")


def free_address() -> str:
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        return f"127.0.0.1:{listener.getsockname()[1]}"


def run_blocks(page: pathlib.Path, base: str, folder: pathlib.Path, programs: pathlib.Path) -> int:
    script = PRELUDE + f"export PATH={programs}:$PATH\n"
    for block in blocks(page):
        script += f"curl_code={22 if block.must_be_refused else 0}\n{block.text}echo; echo '{END}'\n"
    script = script.replace(SERVICE, base)
    for address in FURTHER:
        script = script.replace(address, free_address())
    done = subprocess.run(["bash", "-c", script], cwd=folder, capture_output=True, text=True, timeout=300)
    if done.returncode != 0:
        fail(page, f"a command failed\n{done.stdout[-2000:]}\n{done.stderr[-2000:]}")
    for block, printed in zip(blocks(page), done.stdout.split(END)):
        check_output(page, block, printed)
    for picture in folder.rglob("*.svg"):
        if "<svg" not in picture.read_text():
            fail(page, f"{picture.name} is no picture")
    for document in folder.glob("*.json"):
        json.loads(document.read_text())
    return sum(block.text.count("curl -s") + block.text.count("coaxis ") for block in blocks(page))


def run_page(coaxis: str, page: pathlib.Path) -> None:
    with tempfile.TemporaryDirectory() as scratch:
        programs, folder = pathlib.Path(scratch) / "programs", pathlib.Path(scratch) / "folder"
        programs.mkdir()
        folder.mkdir()
        (programs / "coaxis").symlink_to(coaxis)
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
                fail(page, "the demo did not say where it listens")
            count = run_blocks(page, base, folder, programs)
        finally:
            demo.send_signal(signal.SIGTERM)
            code = demo.wait(timeout=20)
        if code != 0:
            fail(page, f"the demo ended with {code}")
    print(f"{page.relative_to(ROOT)}: {count} commands did what the page states")


def check_documents(coaxis: str) -> None:
    check_problem_table(coaxis)
    lines_count = len(README.read_text().splitlines())
    if lines_count > README_LINES_MAX:
        fail(README, f"{lines_count} lines; at most {README_LINES_MAX}, the rest belongs in docs/")
    for page in LINKING:
        check_links(page)


def main() -> None:
    coaxis = str(pathlib.Path(sys.argv[1]).resolve())
    chosen = [pathlib.Path(name).resolve() for name in sys.argv[2:]]
    if not chosen:
        check_documents(coaxis)
    for page in chosen or [page for page in PAGES if blocks(page)]:
        run_page(coaxis, page)


main()
