"""The container image: built from the Dockerfile as it stands, examined, and run as docker/compose.yaml runs it.

Usage: container.py (as root). buildah builds without a daemon, runc runs the result, and container_base.sh creates the base
image, so no image registry is needed. Images, crates and build products stay in target/container, so that a second run is
short.

The exit code is 1 if the image differs from docs/container.md, and 77 if this machine cannot build or run it: then nothing was
tested.
"""

import contextlib
import json
import os
import pathlib
import re
import shutil
import subprocess
import sys
import time
import tomllib

HOME = pathlib.Path(__file__).resolve().parent.parent
WORK = HOME / "target/container"
IMAGE = "localhost/coaxis:test"
TOOLS = ("buildah", "debootstrap", "runc", "nsenter", "unshare", "curl", "rustc")
BINARY_BYTES_MAX = 45_000_000
START_S = 15
SCAN = HOME / "tests/data/made/interference-arc140.csv"
POSE_OFF_MAX = {"deflection_deg": 0.001, "pitch_deg": 0.001, "y_c0_mm": 0.02, "z_c0_mm": 0.02}
LICENCES = (
    "Mozilla Public License Version 2.0",
    "https://crates.io/crates/async-opcua/",
    "Apache License",
    "GNU LESSER GENERAL PUBLIC LICENSE",
)
# The settings of docker/compose.yaml that the runs below use.
COMPOSE = ("read_only: true", "cap_drop: [ALL]", "no-new-privileges:true", "COAXIS_CONFIG: /etc/coaxis.toml")


def skip(reason):
    print(f"tests/container.py: skipped, nothing was tested: {reason}", file=sys.stderr)
    sys.exit(77)


def check(condition, text):
    if not condition:
        sys.exit(f"tests/container.py: {text}")


def run(*command, code=0):
    """The output of the command; the test fails if the exit code is another."""
    done = subprocess.run(command, cwd=HOME, capture_output=True, text=True, timeout=120)
    check(done.returncode == code, f"{' '.join(map(str, command))}: exit code {done.returncode}\n{done.stdout}{done.stderr}")
    return done.stdout


def base_name():
    """The base image of the Dockerfile, if this machine can create it; otherwise the test is skipped."""
    if os.geteuid() != 0:
        skip("it needs root, for the base image and the namespaces of the container")
    if missing := [tool for tool in TOOLS if not shutil.which(tool)]:
        skip(f"{', '.join(missing)} missing")
    unshare = ["unshare", "--mount", "--net", "--pid", "--ipc", "--uts", "--fork", "true"]
    unshared = subprocess.run(unshare, capture_output=True, text=True)
    if unshared.returncode != 0:
        skip(f"this machine creates no namespaces: {unshared.stderr.strip()}")
    name, wanted = re.search(r"^FROM (rust:([0-9.]+)-\S+) AS", (HOME / "Dockerfile").read_text(), re.M).groups()
    here = run("rustc", "--version").split()[1]
    if here != wanted:
        skip(f"the Dockerfile builds with Rust {wanted}, and this machine has {here}")
    return name


def logged(name, *command):
    """Runs a long command with its output in a file: the exit code, and the end of the output."""
    log = WORK / f"{name}.log"
    with log.open("w") as file:
        code = subprocess.call(command, cwd=HOME, stdout=file, stderr=subprocess.STDOUT)
    return code, f"{log}:\n{log.read_text()[-3000:]}"


def build():
    """Builds the image, and the base image if it does not exist yet."""
    name = base_name()
    (WORK / "tmp").mkdir(parents=True, exist_ok=True)
    storage = WORK / "storage.conf"
    storage.write_text(f'[storage]\ndriver = "overlay"\ngraphroot = "{WORK}/images"\nrunroot = "{WORK}/run"\n')
    # buildah stores the caches that the Dockerfile mounts below TMPDIR.
    os.environ.update(CONTAINERS_STORAGE_CONF=str(storage), TMPDIR=str(WORK / "tmp"))
    # Containers of an interrupted run.
    run("buildah", "rm", "--all")
    if subprocess.run(["buildah", "inspect", "--type", "image", name], capture_output=True).returncode != 0:
        code, end = logged("base", HOME / "tests/container_base.sh", name)
        if code != 0:
            skip(f"the base image {name} cannot be created here (can a Debian mirror be reached?); the end of {end}")
    begin = time.monotonic()
    # Only the format of Docker has a health check.
    code, end = logged(
        "build", "buildah", "bud", "--isolation", "chroot", "--format", "docker", "--pull-never", "--tag", IMAGE, "."
    )
    check(code == 0, f"the image is not built; the end of {end}")
    print(f"built in {time.monotonic() - begin:.0f} s")


def documented():
    """The rows of the tables in docs/container.md: the first cell, and the code spans of the others."""
    rows = re.findall(r"^\| (.+?) \| (.+) \|$", (HOME / "docs/container.md").read_text(), re.M)
    return {first.strip("`"): re.findall(r"`([^`]+)`", others) for first, others in rows}


def settings(config):
    """The configuration of the image in the terms of docs/container.md."""
    health = config.get("Healthcheck")
    check(health, "the image has no health check")
    seconds = [f"{health[key] // 10**9} s" for key in ("Interval", "Timeout", "StartPeriod")]
    return {
        "entrypoint": config["Entrypoint"],
        "command": config["Cmd"],
        "user": [config["User"]],
        "ports": sorted(config["ExposedPorts"]),
        "volumes": sorted(config["Volumes"]),
        "environment": sorted(variable for variable in config["Env"] if not variable.startswith("PATH=")),
        "health check": [" ".join(health["Test"][1:]), *seconds, str(health["Retries"])],
        "stop signal": [config["StopSignal"]],
        "licence": [config["Labels"]["org.opencontainers.image.licenses"]],
    }


def files(root):
    """Everything in the image: owner and mode by path."""
    found = {}
    for path in sorted(root.rglob("*")):
        status = path.lstat()
        found[f"/{path.relative_to(root)}"] = [f"{status.st_uid}:{status.st_gid}", f"{status.st_mode & 0o7777:04o}"]
    return found


def examine(config, root):
    rows = documented()
    for name, value in settings(config).items():
        check(rows.get(name) == value, f"{name} is {value}, and docs/container.md states {rows.get(name)}")
    found, stated = files(root), {path: row for path, row in rows.items() if path.startswith("/")}
    check(found == stated, f"the image contains {found}, and docs/container.md states {stated}")
    check((root / "licences/coaxis.txt").read_bytes() == (HOME / "LICENSE").read_bytes(), "another licence than LICENSE")
    third_party = (root / "licences/third-party.txt").read_text()
    for text in LICENCES:
        check(text in third_party, f"/licences/third-party.txt has no {text!r}")
    size = (root / "coaxis").stat().st_size
    check(size <= BINARY_BYTES_MAX, f"the binary has {size} bytes; at most {BINARY_BYTES_MAX} are allowed")
    print(f"binary {size / 1e6:.1f} MB, image {run('buildah', 'images', '--format', '{{.Size}}', IMAGE).strip()}")


class Container:
    """The image as docker/compose.yaml runs it: read-only root, no capability, no new privilege, a network of its own."""

    def __init__(self, name, config, root, data, variables=(), mounts=()):
        self.name, self.config = name, config
        bundle = WORK / name
        shutil.rmtree(bundle, ignore_errors=True)
        bundle.mkdir()
        run("runc", "spec", "--bundle", bundle)
        spec = json.loads((bundle / "config.json").read_text())
        user, group = map(int, config["User"].split(":"))
        spec["root"] = {"path": str(root), "readonly": True}
        spec["process"] |= {
            "terminal": False,
            "args": config["Entrypoint"] + config["Cmd"],
            "env": config["Env"] + list(variables),
            "cwd": config["WorkingDir"] or "/",
            "user": {"uid": user, "gid": group},
            "capabilities": {},
            "noNewPrivileges": True,
        }
        for source, target, mode in [(data, "/data", "rw"), *mounts]:
            mount = {"source": str(source), "destination": target, "type": "bind", "options": ["bind", mode]}
            spec["mounts"].append(mount)
        (bundle / "config.json").write_text(json.dumps(spec))
        self.log = bundle / "log"
        with self.log.open("w") as log:
            command = self.runc("run", "--bundle", bundle, name)
            self.process = subprocess.Popen(command, stdout=log, stderr=subprocess.STDOUT)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        subprocess.run(self.runc("delete", "--force", self.name), capture_output=True)
        self.process.wait()

    @staticmethod
    def runc(*arguments):
        return ["runc", "--root", WORK / "runc", *arguments]

    def pid(self):
        return json.loads(run(*self.runc("state", self.name)))["pid"]

    def health(self, *flags):
        """The exit code of the health check of the image, None if it takes longer than the image allows."""
        health = self.config["Healthcheck"]
        command = self.runc("exec", *flags, self.name, *health["Test"][1:])
        with contextlib.suppress(subprocess.TimeoutExpired):
            return subprocess.run(command, capture_output=True, timeout=health["Timeout"] / 1e9).returncode
        return None

    def wait_until_healthy(self):
        begin = time.monotonic()
        while self.health() != 0:
            check(self.process.poll() is None, f"the service ended at once:\n{self.log.read_text()[-2000:]}")
            check(time.monotonic() - begin < START_S, f"not healthy after {START_S} s:\n{self.log.read_text()[-2000:]}")
            time.sleep(0.1)
        print(f"{self.name}: healthy after {time.monotonic() - begin:.1f} s")

    def curl(self, path, *arguments):
        """The command that sends a request from within the network of the service."""
        inside = ["nsenter", f"--net=/proc/{self.pid()}/ns/net"]
        return [*inside, "curl", "--silent", "--show-error", "--fail-with-body", *arguments, f"http://127.0.0.1:8080{path}"]

    def ask(self, path, *arguments):
        return json.loads(run(*self.curl(path, "--max-time", "60", *arguments)))

    def stop(self, within_ms):
        """Sends the stop signal of the image, and checks that the service ends in time with exit code 0."""
        begin = time.monotonic()
        run(*self.runc("kill", self.name, self.config["StopSignal"]))
        with contextlib.suppress(subprocess.TimeoutExpired):
            self.process.wait(timeout=within_ms / 1000)
        took_ms = 1000 * (time.monotonic() - begin)
        check(self.process.returncode == 0, f"exit code {self.process.returncode} {took_ms:.0f} ms after the stop signal")
        print(f"{self.name}: ended {took_ms:.0f} ms after {self.config['StopSignal']}")


def check_privileges(container):
    """Checks the user, and that only /data can be written."""
    process = pathlib.Path(f"/proc/{container.pid()}")
    status = dict(line.split(":\t", 1) for line in (process / "status").read_text().splitlines() if ":\t" in line)
    user, none = "\t".join(["65532"] * 4), "0" * 16
    for key, value in {"Uid": user, "Gid": user, "CapEff": none, "CapBnd": none, "NoNewPrivs": "1"}.items():
        check(status[key] == value, f"{key} of the process is {status[key]!r}")
    try:
        (process / "root/licences/written").touch()
        check(False, "the root file system can be written")
    except OSError as error:
        check("Read-only" in str(error), f"the root file system: {error}")


def measure(container):
    """Measures the example scan, and compares the pose with the truth beside the scan: the id of the measurement."""
    answer = container.ask("/v1/measurements?format=csv", "--data-binary", f"@{SCAN}")
    check(answer["verdict"] == "accepted", f"the example scan is {answer}")
    truth = json.loads(SCAN.with_suffix(".truth.json").read_text())
    for name, off_max in POSE_OFF_MAX.items():
        off = abs(answer["pose"][name] - truth[name])
        check(off <= off_max, f"{name} of the example scan is off by {off}")
    return answer["id"]


def serve(config, root):
    """Runs the image twice on one data folder: with its defaults, then with the configuration of docker/."""
    compose, example = (HOME / "docker/compose.yaml").read_text(), HOME / "docker/coaxis.toml"
    for text in COMPOSE:
        check(text in compose, f"docker/compose.yaml has no {text!r}")
    within_ms = tomllib.loads(example.read_text())["timeouts"]["shutdown_ms"]
    data = WORK / "data"
    shutil.rmtree(data, ignore_errors=True)
    # A new volume gets owner and mode from the image.
    shutil.copytree(root / "data", data)
    os.chown(data, (root / "data").stat().st_uid, (root / "data").stat().st_gid)

    with Container("defaults", config, root, data) as container:
        container.wait_until_healthy()
        check(container.health("--env", "COAXIS_LISTEN=0.0.0.0:9") != 0, "the health check succeeds without a service")
        check_privileges(container)
        measured = measure(container)
        owners = {f"{path.stat().st_uid}:{path.stat().st_gid}" for path in data.rglob("*")}
        check(owners == {"65532:65532"}, f"the files in /data belong to {owners}")
        # A client that would stay connected for ever must not delay the shutdown.
        events = container.curl("/v1/events", "--no-buffer", "--header", "Accept: text/event-stream")
        reader = subprocess.Popen(events, stdout=subprocess.PIPE)
        check(reader.stdout.readline() != b"", "no event arrives")
        container.stop(within_ms)
        reader.wait(timeout=10)

    mounts = [(example, "/etc/coaxis.toml", "ro")]
    with Container("compose", config, root, data, ["COAXIS_CONFIG=/etc/coaxis.toml"], mounts) as container:
        container.wait_until_healthy()
        check(container.ask(f"/v1/measurements/{measured}")["id"] == measured, "the measurement is lost")
        check(measure(container) != measured, "a second measurement has the id of the first")
        container.stop(within_ms)
        for line in container.log.read_text().splitlines():
            check(json.loads(line)["message"], f"a line of the log without a message: {line}")


def main():
    build()
    config = json.loads(run("buildah", "inspect", "--type", "image", IMAGE))["Docker"]["config"]
    working = run("buildah", "from", "--pull-never", IMAGE).strip()
    try:
        root = pathlib.Path(run("buildah", "mount", working).strip())
        examine(config, root)
        serve(config, root)
    finally:
        subprocess.run(["buildah", "rm", working], capture_output=True)
    print("the image is as docs/container.md states, serves, measures and ends in time")


if __name__ == "__main__":
    main()
