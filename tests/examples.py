"""Runs the examples, and prints a line for each; the exit code is 1 if one fails.

Usage: examples.py COAXIS (the built command). Starts a demo with its simulated cell on a free port in a temporary folder. The
packages of tests/requirements.txt are taken from tests/.venv, or from the Python named by COAXIS_PYTHON. Checks whose
tools are missing (node, mypy, the grammar) are skipped, and their line names the tool.
"""

import contextlib
import csv
import http.server
import importlib.util
import json
import os
import pathlib
import re
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
import traceback
import typing
import urllib.request

ROOT = pathlib.Path(__file__).resolve().parent.parent
EXAMPLES = ROOT / "examples"
ST = EXAMPLES / "plc" / "coaxis_modbus.st"
VENV = ROOT / "tests" / ".venv" / "bin" / "python"
PYTHON = os.environ.get("COAXIS_PYTHON") or (str(VENV) if VENV.exists() else sys.executable)
TARGET = ["--deflection-deg", "0.2", "--pitch-deg", "0", "--y-c0-mm", "0", "--z-c0-mm", "5"]


class Skipped(Exception):
    pass


class Demo(typing.NamedTuple):
    base: str
    folder: pathlib.Path

    def get(self, path: str) -> typing.Any:
        with urllib.request.urlopen(self.base + path, timeout=10) as answer:
            return json.load(answer)

    def script(self, name: str, *arguments: str, code: int = 0, typed: str = "") -> str:
        command = [sys.executable, str(EXAMPLES / "python" / name), "--url", self.base, *arguments]
        done = subprocess.run(command, cwd=self.folder, input=typed, capture_output=True, text=True, timeout=120)
        assert done.returncode == code, f"{name} ended with {done.returncode} instead of {code}: {done.stdout}{done.stderr}"
        return done.stdout


@contextlib.contextmanager
def demo(coaxis: str) -> typing.Iterator[Demo]:
    with tempfile.TemporaryDirectory() as folder:
        command = [coaxis, "demo", "--listen", "127.0.0.1:0"]
        service = subprocess.Popen(command, cwd=folder, stdout=subprocess.PIPE, text=True)
        try:
            base = ""
            for line in service.stdout:
                found = re.search(r"coaxis listens on (http://\S+)", line)
                base = found.group(1) if found else base
                if "Ctrl-C" in line:
                    break
            assert base, "the demo did not say where it listens"
            yield Demo(base, pathlib.Path(folder))
        finally:
            service.send_signal(signal.SIGTERM)
            assert service.wait(timeout=20) == 0, "the demo ended with an error"


def measure_and_store(demo: Demo) -> None:
    request = urllib.request.Request(
        demo.base + "/v1/recipes/shaft", json.dumps({"nominal_radius_mm": 200}).encode(), method="PUT"
    )
    request.add_header("Content-Type", "application/json")
    request.add_header("If-None-Match", "*")
    urllib.request.urlopen(request, timeout=10).close()
    arguments = ["data/demo/scan.ply", "--recipe", "shaft", "--request-id", "part-1"]
    printed = demo.script("measure_and_store.py", *arguments)
    assert "accepted" in printed and "low_inlier_ratio" in printed, printed
    assert "earlier request" in demo.script("measure_and_store.py", *arguments)
    # Fewer profiles than `profiles_min` are refused: the points of the first x alone.
    (demo.folder / "short.csv").write_text("x,y,z\n" + "".join(f"0,{y},{200 - y * y / 400}\n" for y in range(-50, 51)))
    printed = demo.script("measure_and_store.py", "short.csv", code=2)
    assert "too_few_profiles" in printed, printed
    (demo.folder / "none.csv").write_text("no scan")
    demo.script("measure_and_store.py", "none.csv", code=1)
    demo.script("measure_and_store.py", "absent.csv", code=1)
    rows = list(csv.DictReader((demo.folder / "results.csv").open()))
    assert [row["verdict"] for row in rows] == ["accepted", "refused"], rows
    assert abs(float(rows[0]["deflection_deg"]) - 0.3575) < 0.001 and 0 < float(rows[0]["u_y_c0_mm"]) < 0.01, rows[0]
    assert (rows[0]["recipe"], rows[0]["request_id"], rows[1]["refusal"]) == ("shaft", "part-1", "too_few_profiles"), rows


def errors(printed: str) -> typing.List[typing.List[float]]:
    """The column `error` of each table that scan_plan_move.py prints."""
    found = re.findall(r"^\w+_(?:deg|mm) +\S+ +\S+ +([+-]\S+)   ±", printed, re.M)
    return [[abs(float(number)) for number in found[at : at + 4]] for at in range(0, len(found), 4)]


def scan_plan_move(demo: Demo) -> None:
    moves_count = len(demo.get("/v1/moves")["moves"])
    assert "nothing was moved" in demo.script("scan_plan_move.py", *TARGET, code=3, typed="no\n")
    assert len(demo.get("/v1/moves")["moves"]) == moves_count, "it moved without a confirmation"
    before, after = errors(demo.script("scan_plan_move.py", *TARGET, typed="yes\n"))
    assert max(before) > 1.0 and max(after) < 0.3, (before, after)
    assert demo.get("/v1/cell")["lease"] is None, "the lease was not given back"


def stop_by_ctrl_c(demo: Demo) -> None:
    command = [sys.executable, "-u", str(EXAMPLES / "python" / "scan_plan_move.py"), "--url", demo.base, "--yes"]
    target = ["--deflection-deg", "0", "--pitch-deg", "0", "--y-c0-mm", "0", "--z-c0-mm", "-5", "--speed-ratio", "0.01"]
    # Where this test runs in the background, its shell has made it ignore the signal, and a child inherits that.
    heed = lambda: signal.signal(signal.SIGINT, signal.SIG_DFL)
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    script = subprocess.Popen(command + target, text=True, preexec_fn=heed, **pipes)
    try:
        for line in script.stdout:
            if line.startswith("moves"):
                break
        time.sleep(1.0)
        script.send_signal(signal.SIGINT)
        _, complaints = script.communicate(timeout=20)
    finally:
        script.kill()
    assert script.returncode == 130 and "stop" in complaints, (script.returncode, complaints)
    move = demo.get("/v1/moves?limit=1")["moves"][0]
    move = demo.get(f"/v1/moves/{move['id']}?wait_s=10")
    assert (move["state"], move["ending"]["code"]) == ("stopped", "stop_requested"), move
    deadline = time.monotonic() + 10.0
    while demo.get("/v1/cell")["state"] != "idle":
        assert time.monotonic() < deadline, "the cell did not come to rest"
        time.sleep(0.1)
    assert demo.get("/v1/cell")["lease"] is None, "the lease was not given back"


class Script(http.server.BaseHTTPRequestHandler):
    """A service that answers by the list `answers`: a status with a document, or None for a connection that breaks."""

    answers: typing.List[typing.Optional[typing.Tuple[int, dict, dict]]] = []
    requests: typing.List[typing.Tuple[str, str, bytes]] = []

    def handle_one(self) -> None:
        length = int(self.headers.get("Content-Length") or 0)
        body = self.rfile.read(length)
        self.requests.append((self.command, self.path, body))
        answer = self.answers.pop(0)
        self.close_connection = True
        if answer is None:
            return
        status, document, headers = answer
        content = json.dumps(document).encode()
        self.send_response(status)
        for name, value in {**headers, "Content-Length": str(len(content))}.items():
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(content)

    do_GET = do_POST = do_DELETE = handle_one

    def log_message(self, *_: object) -> None:
        pass


def client_repeats_what_is_safe(demo: Demo) -> None:
    path = EXAMPLES / "python" / "coaxis_client.py"
    specification = importlib.util.spec_from_file_location("coaxis_client", path)
    client = importlib.util.module_from_spec(specification)
    sys.modules["coaxis_client"] = client
    specification.loader.exec_module(client)
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Script)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    service = client.Client(f"http://127.0.0.1:{server.server_port}", timeout_s=5.0, attempts_max=3)
    busy = (503, {"code": "busy", "detail": "busy", "retryable": True, "queue_max": 16}, {"Retry-After": "0"})
    move = (200, {"id": "v-1", "state": "moving", "progress": 0.0, "ending": None}, {})
    cell = (200, {"state": "idle", "commands_allowed": True, "reasons": [], "faults": []}, {})
    lease = (201, {"lease_id": "l-1", "ttl_ms": 60000}, {})
    measurement = (201, {"id": "m-1", "state": "scanning", "created_at": "t", "verdict": None}, {})

    def answered(*answers: object) -> None:
        Script.answers[:], Script.requests[:] = answers, []

    def sent() -> int:
        return len(Script.requests)

    def refused(kind: type, call: typing.Callable[[], object]) -> Exception:
        try:
            call()
        except kind as error:
            return error
        raise AssertionError(f"{kind.__name__} was expected")

    try:
        answered(busy, None, cell)
        assert service.cell().state == "idle" and sent() == 3
        answered(busy, busy, busy)
        problem = refused(client.Problem, service.cell)
        assert (problem.code, problem.status, problem.numbers, sent()) == ("busy", 503, {"queue_max": 16}, 3)
        answered(lease)
        kept = service.lease("test", ttl_s=60.0)
        kept.__enter__()
        # A scan and a move keep their request id, so that the service recognises the repetition.
        answered(None, busy, measurement)
        assert service.measure_with_sensor(kept).id == "m-1" and len({body for _, _, body in Script.requests}) == 1
        assert b'"request_id"' in Script.requests[0][2]
        answered(None, move)
        assert service.move_axes({"m1": {"z_mm": 1.0}}, kept).id == "v-1" and len({body for _, _, body in Script.requests}) == 1
        answered(None, move)
        assert service.execute("p-1", kept).id == "v-1" and sent() == 2
        # Nothing recognises the repetition of these.
        for call in (lambda: service.home("m1", kept), lambda: service.enable("m1", kept), lambda: service.reset(kept)):
            answered(None, move)
            refused(client.ConnectionFailed, call)
            assert sent() == 1, "a command without request_id was sent twice"
            answered(busy, move)
            refused(client.Problem, call)
            assert sent() == 1, "a command without request_id was sent twice"
        answered((409, {"code": "cell_busy", "retryable": True}, {}))
        assert refused(client.Problem, lambda: service.execute("p-1", kept)).code == "cell_busy" and sent() == 1
        answered((200, {"id": "v-1"}, {}))
        refused(client.AnswerInvalid, lambda: service.move("v-1"))
        answered((409, {"code": "lease_over"}, {}))
        kept.__exit__(None, None, None)
        assert Script.requests[0][:2] == ("DELETE", "/v1/cell/lease?lease_id=l-1"), Script.requests
        # A lease that cannot be renewed is lost, and says so before the next command is sent.
        answered((201, {"lease_id": "l-2", "ttl_ms": 60}, {}), (409, {"code": "lease_over", "detail": "over"}, {}))
        with service.lease("test", ttl_s=0.06) as short:
            deadline = time.monotonic() + 5.0
            while sent() < 2 and time.monotonic() < deadline:
                time.sleep(0.01)
            time.sleep(0.1)
            refused(client.LeaseLost, lambda: service.home("m1", short))
        assert sent() == 2, Script.requests
        # A large file that is refused before it was read: the answer is seen, not the broken pipe.
        with tempfile.NamedTemporaryFile() as file:
            file.truncate(64 * 1024 * 1024)
            big = client.Client(demo.base, attempts_max=1)
            problem = refused(client.Problem, lambda: big.measure_file(pathlib.Path(file.name), recipe="absent"))
            assert problem.code == "recipe_unknown", problem
    finally:
        server.shutdown()
        server.server_close()


def has_module(name: str) -> bool:
    return subprocess.run([PYTHON, "-c", f"import {name}"], capture_output=True).returncode == 0


def python_types(_: Demo) -> None:
    if not has_module("mypy"):
        raise Skipped("mypy is not installed; tests/run installs it")
    files = sorted(str(path) for path in (EXAMPLES / "python").glob("*.py"))
    with tempfile.TemporaryDirectory() as cache:
        command = [PYTHON, "-m", "mypy", "--strict", "--cache-dir", cache, *files]
        done = subprocess.run(command, cwd=EXAMPLES / "python", capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stdout + done.stderr


def node_red(demo: Demo) -> None:
    if shutil.which("node") is None:
        raise Skipped("node is not installed")
    flow = EXAMPLES / "node-red" / "coaxis-flow.json"
    scan = demo.folder / "data" / "demo" / "scan.ply"
    command = ["node", str(ROOT / "tests" / "node_red.mjs"), str(flow), demo.base, str(scan)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stdout + done.stderr


def free_port() -> int:
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        return listener.getsockname()[1]


def node_red_headless(demo: Demo) -> None:
    program = os.environ.get("NODE_RED") or shutil.which("node-red")
    if program is None:
        raise Skipped("Node-RED is not installed; NODE_RED may name it")
    nodes = json.loads((EXAMPLES / "node-red" / "coaxis-flow.json").read_text())
    settings = {"COAXIS_URL": demo.base, "SCAN_FILE": str(demo.folder / "data" / "demo" / "scan.ply"), "RECIPE": ""}
    tab = next(node for node in nodes if node["type"] == "tab")
    tab["env"] = [{"name": name, "value": value, "type": "str"} for name, value in settings.items()]
    button = next(node["id"] for node in nodes if node.get("name") == "Measure the file")
    port = free_port()
    with tempfile.TemporaryDirectory() as folder:
        (pathlib.Path(folder) / "flows.json").write_text(json.dumps(nodes))
        command = [program, "--userDir", folder, "-p", str(port), "flows.json"]
        runtime = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)

        def answer(path: str, method: str = "GET") -> typing.Any:
            request = urllib.request.Request(f"http://127.0.0.1:{port}{path}", method=method)
            with urllib.request.urlopen(request, timeout=10) as response:
                return json.loads(response.read())

        def wait_for(reached: typing.Callable[[], object]) -> None:
            deadline = time.monotonic() + 60.0
            while True:
                with contextlib.suppress(OSError):
                    if reached():
                        return
                assert time.monotonic() < deadline and runtime.poll() is None, "Node-RED does not show the expected state"
                time.sleep(0.2)

        try:
            wait_for(lambda: answer("/coaxis/state")["cell"]["state"] == "idle")
            pressed = urllib.request.Request(f"http://127.0.0.1:{port}/inject/{button}", method="POST")
            urllib.request.urlopen(pressed, timeout=10).close()
            wait_for(lambda: (answer("/coaxis/state")["measurement"] or {}).get("verdict") == "accepted")
            assert isinstance(answer("/coaxis/stop", "POST")["confirmed"], bool)
        finally:
            runtime.terminate()
            runtime.wait(timeout=20)


def section(page: str, heading: str) -> str:
    return page.split(f"\n## {heading}")[1].split("\n## ")[0]


def table(text: str) -> typing.Dict[int, typing.Tuple[str, str]]:
    """Offset -> type and meaning, of the rows of a table of registers."""
    rows = re.findall(r"^\| (\d+) \| ([^|]*) \| ([^|]*) \|$", text, re.M)
    return {int(offset): (kind.strip().replace("×", "x"), meaning.strip()) for offset, kind, meaning in rows}


def listed(text: str) -> typing.Dict[str, int]:
    """The names and numbers of `1 enable, 2 disable, …`."""
    return {name.strip().upper().replace(" ", "_"): int(number) for number, name in re.findall(r"(\d+) ([a-z ]+)", text)}


def structured_text_and_map(_: Demo) -> None:
    page = (ROOT / "docs" / "modbus.md").read_text()
    text = ST.read_text()
    maps = {"status": table(section(page, "Status")), "command": table(section(page, "Command"))}
    named: typing.Dict[str, typing.Set[int]] = {"status": set(), "command": set()}
    for line in text.splitlines():
        for block, offset, kind in re.findall(r"\(\* (status|command) (\d+)(?:: (\w+(?: x \d)?))?[^*]*\*\)", line):
            assert int(offset) in maps[block], f"docs/modbus.md has no {block} register {offset}: {line}"
            named[block].add(int(offset))
            stated = maps[block][int(offset)][0]
            assert not kind or kind == stated, f"docs/modbus.md has {stated} at {block} {offset}: {line}"
            used = re.search(r"(?:status|registers)\[(\d+)", line)
            assert not used or used.group(1) == offset, f"the comment names another register: {line}"
            group = re.match(r" +(\d): number := axes\[i\]\.(\w+)", line)
            assert not group or 16 + 8 * int(group.group(1)) == int(offset), f"the comment names another register: {line}"
            words = {"actual": "actual", "commanded": "commanded", "lower": "lower", "upper": "upper", "speed_max": "speed"}
            assert not group or words[group.group(2)] in maps["status"][int(offset)][1], f"another quantity: {line}"
    for block, rows in maps.items():
        needed = {offset for offset, (kind, meaning) in rows.items() if kind and "not used" not in meaning}
        assert len(needed) > 5 and needed <= named[block], f"{ST.name} lacks {block} {sorted(needed - named[block])}"
    codes = listed(maps["command"][1][1])
    results = listed(maps["status"][7][1].split(":")[1])
    modes = listed(maps["status"][3][1])
    states = {name.upper(): int(number) for name, number in re.findall(r"^\| `(\w+)` \| (\d) \|", page, re.M)}
    assert (len(codes), len(results), len(states)) == (6, 6, 8), (codes, results, states)
    for prefix, numbers in (("CODE", codes), ("RESULT", results), ("STATE", states), ("MODE", modes)):
        stated = {name: int(value) for name, value in re.findall(rf"{prefix}_(\w+) : UINT := (\d+)", text)}
        assert stated and all(numbers.get(name) == value for name, value in stated.items()), (prefix, stated, numbers)
    assert set(re.findall(r"CODE_(\w+) : UINT", text)) == set(codes)
    labels = {name: int(number) for number, name in re.findall(r"(\d): \(\* CODE_(\w+)", text)}
    assert labels == codes, (labels, codes)
    assert f"magic 0x{re.search('MAGIC : WORD := 16#(....)', text).group(1)}" in maps["status"][0][1]
    bits = {name: int(number) for number, name in re.findall(r"(\d) ([a-z ]+)", maps["status"][4][1])}
    shifts = dict(re.findall(r"SHL\(BOOL_TO_WORD\((\w+)\), (\d)\)", text))
    for name in ("guard_closed", "drives_ready", "remote_enabled"):
        assert int(shifts[name]) == bits[name.replace("_", " ")], (shifts, bits)
    axis_bits = dict(re.findall(r"(homed|in position|fault|limit hit) (\d+)-", maps["status"][10][1]))
    shifts = dict(re.findall(r"SHL\(BOOL_TO_WORD\(axes\[i\]\.(\w+)\), i(?: \+ (\d+))?\)", text))
    words = {"homed": "homed", "at_target": "in position", "faulted": "fault", "limit_hit": "limit hit"}
    assert {name: shifts[name] or "0" for name in words} == {name: axis_bits[word] for name, word in words.items()}, shifts
    assert "registers 0-20" in maps["command"][21][1] and "FOR i := 1 TO 20 DO" in text
    assert "ahead <= 32767" in text and "≤ 32767" in page and "upper bound is 500 ms" in page.replace("\n   ", " ")
    assert "MIN(command.watchdog_ms, 500)" in text
    assert "m2 256, the stage 512" in page and "m2 at base 256, the stage at base 512" in text
    assert "base + 128" in page and "the command from base + 128" in text


def structured_text_syntax(_: Demo) -> None:
    if not has_module("tree_sitter, tree_sitter_iec61131_3_st"):
        raise Skipped("the grammar is not installed; tests/run installs it")
    program = """
import sys, tree_sitter, tree_sitter_iec61131_3_st as grammar
def faults(node):
    if node.is_error or node.is_missing:
        yield f"line {node.start_point.row + 1}: {node.type}"
    elif node.has_error:
        for child in node.children:
            yield from faults(child)
parser = tree_sitter.Parser(tree_sitter.Language(grammar.language()))
broken = parser.parse(b"PROGRAM p VAR i : INT; END_VAR i := ; END_PROGRAM").root_node
assert list(faults(broken)), "the grammar accepts anything"
sys.exit("; ".join(faults(parser.parse(sys.stdin.buffer.read()).root_node)) or 0)
"""
    for path in sorted(ST.parent.glob("*.st")):
        # The grammar does not know lengths of strings, which the standard has.
        text = re.sub(r"STRING\[\d+\]", "STRING", path.read_text()).encode()
        done = subprocess.run([PYTHON, "-c", program], input=text, capture_output=True, timeout=60)
        assert done.returncode == 0, f"{path.name}: {done.stderr.decode()}"


def structured_text_and_api(_: Demo) -> None:
    text = (ST.parent / "coaxis_rest.st").read_text()
    document = json.loads((ROOT / "openapi" / "coaxis.json").read_text())
    schemas = document["components"]["schemas"]
    members = {key for name in ("PlcCell", "PlcMeasurement", "PlcSensorMeasurement") for key in schemas[name]["properties"]}
    keys = set(re.findall(r"COAXIS_JSON_INTEGER\(text, '(\w+)'", text))
    assert len(keys) > 8 and keys <= members, f"view=plc has no {sorted(keys - members)}"
    paths = {re.sub(r"\{\w+\}$", "", path) for path in document["paths"]}
    named = {path.split("?")[0] for path in re.findall(r"'(/v1/[^']+)'", text)}
    assert len(named) == 5 and named <= paths, f"the API has no {sorted(named - paths)}"


EXAMPLES_RUN = {
    "python/measure_and_store.py": measure_and_store,
    "python/scan_plan_move.py": scan_plan_move,
    "python/scan_plan_move.py stopped by Ctrl-C": stop_by_ctrl_c,
    "python/coaxis_client.py: what is repeated": client_repeats_what_is_safe,
    "python: types (mypy --strict)": python_types,
    "node-red/coaxis-flow.json": node_red,
    "node-red/coaxis-flow.json in Node-RED": node_red_headless,
    "plc/coaxis_modbus.st against docs/modbus.md": structured_text_and_map,
    "plc/coaxis_rest.st against openapi/coaxis.json": structured_text_and_api,
    "plc: syntax": structured_text_syntax,
}


def main() -> int:
    failed = False
    with demo(str(pathlib.Path(sys.argv[1]).resolve())) as running:
        for name, run in EXAMPLES_RUN.items():
            try:
                run(running)
                print(f"examples/{name}: ok", flush=True)
            except Skipped as reason:
                print(f"examples/{name}: skipped: {reason}", flush=True)
            except Exception:
                failed = True
                print(f"examples/{name}: FAILED\n{traceback.format_exc()}", flush=True)
    return 1 if failed else 0


if __name__ == "__main__":
    os.environ["PYTHONDONTWRITEBYTECODE"] = "1"
    sys.dont_write_bytecode = True
    sys.exit(main())
