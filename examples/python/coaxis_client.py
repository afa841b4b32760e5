"""A typed client for coaxis: measure a scan, scan with the sensor, plan and move, stop.

It needs Python 3.9 or later and nothing but the standard library. Copy this file into your project.

    service = Client("http://127.0.0.1:8080")
    measured = service.measure_file(Path("scan.ply"), recipe="shaft", request_id="part-4711")
    print(measured.verdict, measured.pose)

Three rules decide which request is sent a second time:

* A request that reads, and a stop, may be repeated.
* A request that stores something or moves something is repeated only if the service recognises the repetition: by
  its `request_id`, or because executing the same plan again answers the same move.
* Everything else (homing, enabling, resetting, taking the lease) is sent once. If its answer is lost, the caller
  reads the state of the cell and decides.

A repetition follows a broken connection, a time-out or an answer with status 429 or 503, after the time in
`Retry-After`, at most `attempts_max` times in all.
"""

from __future__ import annotations

import dataclasses
import http.client
import json
import ssl
import threading
import time
import urllib.parse
import uuid
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO, Dict, Iterator, Mapping, Optional, Tuple, Type, TypeVar, Union

Json = Dict[str, Any]
T = TypeVar("T")
Query = Mapping[str, Union[str, float, int, None]]

# No answer to this client is longer; a longer one does not come from coaxis.
ANSWER_BYTES_MAX = 64 * 1024 * 1024
# The longest wait that one request asks for; the service allows 60 s.
WAIT_S_MAX = 20
STATUS_REPEATED = (429, 503)


class CoaxisError(Exception):
    """Everything that this module raises."""


class ConnectionFailed(CoaxisError):
    """The service gave no answer. Whether it has executed the request is not known."""


class AnswerInvalid(CoaxisError):
    """The answer is not one that coaxis gives."""


class WaitTimeout(CoaxisError):
    """The measurement or the move had not ended when the caller's time was over. It continues."""


class LeaseLost(CoaxisError):
    """The lease could not be renewed. The service stops what it moved."""


class Problem(CoaxisError):
    """An answer with a status of 400 or above: `application/problem+json`."""

    def __init__(self, status: int, document: Json, retry_after_s: Optional[float]) -> None:
        self.status = status
        self.code = str(document.get("code", "unknown"))
        self.title = str(document.get("title", ""))
        self.detail = str(document.get("detail", ""))
        self.retryable = document.get("retryable") is True
        # Names this request in the log of the service. It is not the `request_id` that the caller has chosen.
        self.log_id = str(document.get("request_id", ""))
        # The numbers that decided, such as `remaining_ms`.
        self.numbers = {key: value for key, value in document.items() if key not in PROBLEM_MEMBERS}
        self.retry_after_s = retry_after_s
        super().__init__(f"{self.code} ({status}): {self.detail or self.title}")


PROBLEM_MEMBERS = ("type", "title", "status", "detail", "code", "request_id", "retryable")


@dataclasses.dataclass(frozen=True)
class Pose:
    """The axis of a part in the rail frame. The angles and positions are None where the axis is not along the rail."""

    frame: str
    deflection_deg: Optional[float]
    pitch_deg: Optional[float]
    y_c0_mm: Optional[float]
    z_c0_mm: Optional[float]
    x_ref_mm: Optional[float]
    radius_mm: float
    radius_source: str
    document: Json = dataclasses.field(repr=False)


@dataclasses.dataclass(frozen=True)
class Uncertainty:
    """Expanded uncertainties with the coverage factor `coverage_factor`."""

    coverage_factor: float
    scope: str
    deflection_deg: Optional[float]
    pitch_deg: Optional[float]
    y_c0_mm: Optional[float]
    z_c0_mm: Optional[float]
    radius_mm: Optional[float]
    document: Json = dataclasses.field(repr=False)


@dataclasses.dataclass(frozen=True)
class Reason:
    """Why a measurement is refused, what it warns of, or why the cell does not move."""

    code: str
    detail: str
    numbers: Json


@dataclasses.dataclass(frozen=True)
class ProfileCounts:
    total_count: int
    valid_count: int
    rejected: Dict[str, int]


@dataclasses.dataclass(frozen=True)
class Part:
    """One part of a scan. `name` is None where the recipe does not divide the scan into parts."""

    name: Optional[str]
    verdict: str
    pose: Optional[Pose]
    uncertainty: Optional[Uncertainty]
    profiles: ProfileCounts
    warnings: Tuple[Reason, ...]
    refusal: Optional[Reason]


@dataclasses.dataclass(frozen=True)
class Measurement:
    """A measurement. `verdict` is None while the sensor scans, and after a scan that failed."""

    id: str
    state: str
    created_at: str
    verdict: Optional[str]
    method: Optional[str]
    refusal: Optional[Reason]
    failure: Optional[Reason]
    parts: Tuple[Part, ...]
    recipe_name: Optional[str]
    scan_sha256: Optional[str]
    # True where the service gave the answer of an earlier request with this `request_id`.
    replayed: bool
    document: Json = dataclasses.field(repr=False)

    @property
    def accepted(self) -> bool:
        return self.verdict == "accepted"

    @property
    def pose(self) -> Optional[Pose]:
        """The pose, if the measurement has exactly one part."""
        return self.parts[0].pose if len(self.parts) == 1 else None

    @property
    def uncertainty(self) -> Optional[Uncertainty]:
        return self.parts[0].uncertainty if len(self.parts) == 1 else None


@dataclasses.dataclass(frozen=True)
class Profile:
    """The verdict on one profile."""

    index: int
    x_mm: float
    points_count: int
    verdict: str
    reason: Optional[str]
    document: Json = dataclasses.field(repr=False)


@dataclasses.dataclass(frozen=True)
class Target:
    """Where the axis of the part is to be, in the rail frame."""

    deflection_deg: float
    pitch_deg: float
    y_c0_mm: float
    z_c0_mm: float
    roll_deg: float = 0.0
    shift_x_mm: float = 0.0


@dataclasses.dataclass(frozen=True)
class Plan:
    """What every axis would do. A plan moves nothing."""

    id: str
    measurement_id: str
    expires_at: str
    duration_s: float
    strain_mm: float
    waypoints_count: int
    document: Json = dataclasses.field(repr=False)


@dataclasses.dataclass(frozen=True)
class Move:
    id: str
    state: str
    progress: float
    ending: Optional[Reason]
    replayed: bool
    document: Json = dataclasses.field(repr=False)

    @property
    def ended(self) -> bool:
        return self.state != "moving"


@dataclasses.dataclass(frozen=True)
class Cell:
    state: str
    commands_allowed: bool
    reasons: Tuple[Reason, ...]
    faults: Tuple[Reason, ...]
    lease_holder: Optional[str]
    document: Json = dataclasses.field(repr=False)


@dataclasses.dataclass(frozen=True)
class StopReport:
    """The result of a stop. Assume that the axes in `unconfirmed_axes` move until the cell is idle."""

    confirmed: bool
    unconfirmed_axes: Tuple[str, ...]
    sent_ms: int
    document: Json = dataclasses.field(repr=False)


class Client:
    """Sends requests to one service. Each request has its own connection, so it may be used by several threads."""

    def __init__(
        self,
        base_url: str = "http://127.0.0.1:8080",
        *,
        timeout_s: float = 10.0,
        calculation_timeout_s: float = 90.0,
        attempts_max: int = 4,
        retry_after_max_s: float = 10.0,
        headers: Optional[Mapping[str, str]] = None,
        tls: Optional[ssl.SSLContext] = None,
    ) -> None:
        """`timeout_s` bounds each step of a connection. `calculation_timeout_s` replaces it where the answer follows a
        calculation; the service itself gives up after `timeouts.calculation_ms`. `headers` are for a reverse proxy."""
        address = urllib.parse.urlsplit(base_url)
        if address.scheme not in ("http", "https") or not address.hostname:
            raise ValueError(f"{base_url!r} is not an address such as http://127.0.0.1:8080")
        if attempts_max < 1:
            raise ValueError("attempts_max has to be at least 1")
        self._secure = address.scheme == "https"
        self._host = address.hostname
        self._port = address.port
        self._prefix = address.path.rstrip("/")
        self._timeout_s = timeout_s
        self._calculation_timeout_s = calculation_timeout_s
        self._attempts_max = attempts_max
        self._retry_after_max_s = retry_after_max_s
        self._headers = dict(headers or {})
        self._tls = tls

    def ready(self) -> bool:
        """Whether the service can work at this moment."""
        try:
            self._call("GET", "/health/ready", repeatable=False)
        except (Problem, ConnectionFailed):
            return False
        return True

    def measure_file(
        self,
        path: Path,
        *,
        recipe: Optional[str] = None,
        request_id: Optional[str] = None,
        options: Optional[Query] = None,
    ) -> Measurement:
        """Uploads a scan file and measures it. The file is sent in blocks, so its size does not matter for the memory.

        A call with the same `request_id`, the same file and the same options returns the first result again. Without a
        `request_id` one is generated for this call. `options` are query parameters, such as `{"format": "ply"}`.
        """
        query = {**(options or {}), "recipe": recipe, "request_id": request_id or str(uuid.uuid4())}
        with path.open("rb") as file:
            answer = self._call("POST", "/v1/measurements", query, file=file, timeout_s=self._calculation_timeout_s)
        return _measurement(answer)

    def measure_with_sensor(
        self, lease: Lease, *, recipe: Optional[str] = None, request_id: Optional[str] = None, options: Optional[Json] = None
    ) -> Measurement:
        """Begins a scan by the sensor of the cell, which moves the stage and switches the laser on.

        The answer comes at once in state `scanning`; `wait_measurement` returns the result. `options` are members of the
        request, such as `{"profiles_count": 200}`.
        """
        body = {**(options or {}), "source": "sensor", "request_id": request_id or str(uuid.uuid4())}
        if recipe is not None:
            body["recipe"] = recipe
        return _measurement(self._call("POST", "/v1/measurements", {"lease_id": lease.current_id()}, body=body))

    def measurement(self, measurement_id: str, *, wait_s: int = 0) -> Measurement:
        path = f"/v1/measurements/{_segment(measurement_id)}"
        return _measurement(self._call("GET", path, {"wait_s": wait_s or None}, timeout_s=self._timeout_s + wait_s))

    def wait_measurement(self, measurement_id: str, *, timeout_s: float, lease: Optional[Lease] = None) -> Measurement:
        """Waits until a scan by the sensor has ended and its pose is calculated."""
        for wait_s in _waits(timeout_s, f"the measurement {measurement_id}"):
            measured = self.measurement(measurement_id, wait_s=wait_s)
            if measured.state != "scanning":
                return measured
            if lease is not None:
                lease.current_id()
        raise AssertionError("_waits ends with an exception")

    def profiles(self, measurement_id: str) -> Iterator[Profile]:
        """The verdict on every profile, page by page."""
        cursor: Optional[str] = None
        path = f"/v1/measurements/{_segment(measurement_id)}/profiles"
        while True:
            page = self._call("GET", path, {"limit": 1000, "cursor": cursor}).document
            for profile in _list(page, "profiles"):
                yield _build(Profile, profile, document=profile)
            cursor = page.get("next_cursor")
            if cursor is None:
                return

    def cell(self) -> Cell:
        document = self._call("GET", "/v1/cell").document
        lease = document.get("lease")
        return _build(
            Cell,
            document,
            reasons=tuple(_reason(reason) for reason in _list(document, "reasons")),
            faults=tuple(_reason(fault) for fault in _list(document, "faults")),
            lease_holder=lease.get("holder") if isinstance(lease, dict) else None,
            document=document,
        )

    def lease(self, holder: str, *, ttl_s: float = 10.0, kept_max_s: float = 600.0) -> Lease:
        """The right to move, for use in a `with` statement."""
        return Lease(self, holder, ttl_s, kept_max_s)

    def plan(
        self, measurement_id: str, target: Target, *, speed_ratio: float = 1.0, request_id: Optional[str] = None
    ) -> Plan:
        """Plans how the part reaches the target. Nothing moves."""
        body = {
            "measurement_id": measurement_id,
            "target": dataclasses.asdict(target),
            "speed_ratio": speed_ratio,
            "request_id": request_id or str(uuid.uuid4()),
        }
        document = self._call("POST", "/v1/plans", body=body).document
        return _build(Plan, document, document=document)

    def execute(self, plan_id: str, lease: Lease) -> Move:
        """Moves by a plan. Executing a plan again answers the same move and moves nothing again."""
        path = f"/v1/plans/{_segment(plan_id)}/execute"
        return _move(self._call("POST", path, {"lease_id": lease.current_id()}, repeatable=True))

    def move_axes(self, axes: Json, lease: Lease, *, request_id: Optional[str] = None) -> Move:
        """Moves single axes to absolute positions, such as `{"m1": {"z_mm": 2.0}, "m2": {"z_mm": 2.0}}`."""
        body = {**axes, "request_id": request_id or str(uuid.uuid4())}
        return _move(self._call("POST", "/v1/moves", {"lease_id": lease.current_id()}, body=body))

    def move(self, move_id: str, *, wait_s: int = 0) -> Move:
        path = f"/v1/moves/{_segment(move_id)}"
        return _move(self._call("GET", path, {"wait_s": wait_s or None}, timeout_s=self._timeout_s + wait_s))

    def wait_move(self, move_id: str, *, timeout_s: float, lease: Optional[Lease] = None) -> Move:
        for wait_s in _waits(timeout_s, f"the move {move_id}"):
            move = self.move(move_id, wait_s=wait_s)
            if move.ended:
                return move
            if lease is not None:
                lease.current_id()
        raise AssertionError("_waits ends with an exception")

    def enable(self, manipulator: str, lease: Lease) -> str:
        return self._command(f"/v1/manipulators/{_segment(manipulator)}/enable", lease)

    def disable(self, manipulator: str, lease: Lease) -> str:
        return self._command(f"/v1/manipulators/{_segment(manipulator)}/disable", lease)

    def home(self, manipulator: str, lease: Lease) -> str:
        """Finds the references of the axes, which moves them."""
        return self._command(f"/v1/manipulators/{_segment(manipulator)}/home", lease)

    def reset(self, lease: Lease) -> None:
        """Ends the state `faulted`. Look at the cell before you call this."""
        self._call("POST", "/v1/cell/reset", {"lease_id": lease.current_id()}, repeatable=False)

    def stop(self) -> StopReport:
        """Stops every device. It needs no lease. It is an operational stop, not an emergency stop."""
        document = self._call("POST", "/v1/cell/stop", timeout_s=min(self._timeout_s, 2.0), repeatable=True).document
        axes = document.get("unconfirmed_axes")
        return _build(StopReport, document, unconfirmed_axes=tuple(axes or ()), document=document)

    def _command(self, path: str, lease: Lease) -> str:
        answer = self._call("POST", path, {"lease_id": lease.current_id()}, repeatable=False)
        return str(answer.document.get("result", ""))

    def _call(
        self,
        method: str,
        path: str,
        query: Optional[Query] = None,
        *,
        body: Optional[Json] = None,
        file: Optional[BinaryIO] = None,
        timeout_s: Optional[float] = None,
        repeatable: Optional[bool] = None,
    ) -> _Answer:
        """Sends one request, and repeats it where that is safe. `repeatable` None is decided by method and request_id."""
        parameters = {key: value for key, value in (query or {}).items() if value is not None}
        if repeatable is None:
            repeatable = method == "GET" or "request_id" in parameters or "request_id" in (body or {})
        address = self._prefix + path + ("?" + urllib.parse.urlencode(parameters) if parameters else "")
        attempts_max = self._attempts_max if repeatable else 1
        attempt = 0
        while True:
            attempt += 1
            try:
                return self._send(method, address, body, file, timeout_s or self._timeout_s)
            except Problem as problem:
                if attempt >= attempts_max or problem.status not in STATUS_REPEATED:
                    raise
                pause_s = problem.retry_after_s
            except ConnectionFailed:
                if attempt >= attempts_max:
                    raise
                pause_s = None
            # A request to stop is repeated at once.
            if not path.endswith("/cell/stop"):
                pause_s = 0.25 * 2**attempt if pause_s is None else pause_s
                time.sleep(min(pause_s, self._retry_after_max_s))

    def _send(
        self, method: str, address: str, body: Optional[Json], file: Optional[BinaryIO], timeout_s: float
    ) -> _Answer:
        headers = {"Accept": "application/json, application/problem+json", **self._headers, "Connection": "close"}
        payload: Union[bytes, BinaryIO, None] = None
        if file is not None:
            file.seek(0, 2)
            headers["Content-Length"] = str(file.tell())
            file.seek(0)
            payload = file
        elif body is not None:
            headers["Content-Type"] = "application/json"
            payload = json.dumps(body, allow_nan=False).encode()
        connection = self._connection(timeout_s)
        try:
            try:
                connection.request(method, address, payload, headers)
            except (BrokenPipeError, ConnectionResetError):
                # The service answers before it has read the whole file where it refuses the request. The answer is
                # read below; if there is none, that fails.
                pass
            response = connection.getresponse()
            content = response.read(ANSWER_BYTES_MAX + 1)
        except (OSError, http.client.HTTPException) as error:
            raise ConnectionFailed(f"no answer to {method} {address.split('?')[0]}: {error!r}") from error
        finally:
            connection.close()
        if len(content) > ANSWER_BYTES_MAX:
            raise AnswerInvalid(f"the answer to {method} {address.split('?')[0]} has more than {ANSWER_BYTES_MAX} bytes")
        return _answer(response.status, response.headers, content)

    def _connection(self, timeout_s: float) -> http.client.HTTPConnection:
        if self._secure:
            return http.client.HTTPSConnection(self._host, self._port, timeout=timeout_s, context=self._tls)
        return http.client.HTTPConnection(self._host, self._port, timeout=timeout_s)


class Lease:
    """The lease of the cell as a context manager: it is taken on entry, renewed, and given back on exit.

    A thread renews the lease every third of its time to live, for at most `kept_max_s`, so that a program that hangs does
    not keep the cell for ever. If the program dies, the lease ends after `ttl_s`. Either end, and giving the lease back,
    stops what the lease moves.
    """

    def __init__(self, client: Client, holder: str, ttl_s: float, kept_max_s: float) -> None:
        self._client = client
        self._holder = holder
        self._ttl_s = ttl_s
        self._kept_max_s = kept_max_s
        self._lease_id: Optional[str] = None
        self._lost: Optional[str] = None
        self._closing = threading.Event()
        self._thread: Optional[threading.Thread] = None

    def __enter__(self) -> Lease:
        if self._lease_id is not None:
            raise CoaxisError("this lease was taken already")
        document = self._client._call(
            "POST", "/v1/cell/lease", body={"holder": self._holder, "ttl_s": self._ttl_s}, repeatable=False
        ).document
        try:
            self._lease_id = str(document["lease_id"])
            self._ttl_s = float(document["ttl_ms"]) / 1000.0
        except (KeyError, TypeError, ValueError) as error:
            raise AnswerInvalid(f"the answer is no lease: {error!r}") from error
        self._thread = threading.Thread(target=self._keep, name="coaxis lease", daemon=True)
        self._thread.start()
        return self

    def __exit__(
        self, kind: Optional[Type[BaseException]], error: Optional[BaseException], trace: Optional[TracebackType]
    ) -> None:
        self._closing.set()
        if self._thread is not None:
            self._thread.join(timeout=self._ttl_s)
        if self._lease_id is None or self._lost is not None:
            return
        try:
            self._client._call("DELETE", "/v1/cell/lease", {"lease_id": self._lease_id}, repeatable=True)
        except Problem as problem:
            # A lease that is over already is what was wanted. It must not hide an exception of the block, either.
            if problem.code != "lease_over" and kind is None:
                raise
        except ConnectionFailed:
            if kind is None:
                raise

    def current_id(self) -> str:
        """The id to send with a command. Raises `LeaseLost` if the lease could not be renewed."""
        if self._lost is not None:
            raise LeaseLost(self._lost)
        if self._lease_id is None:
            raise CoaxisError("the lease is taken by a `with` statement")
        return self._lease_id

    def _keep(self) -> None:
        began = renewed = time.monotonic()
        while not self._closing.wait(self._ttl_s / 3.0):
            if time.monotonic() - began > self._kept_max_s:
                self._lost = f"the lease was kept for {self._kept_max_s:g} s, the maximum, and is not renewed any more"
                return
            try:
                sent = time.monotonic()
                self._client._call(
                    "POST",
                    "/v1/cell/lease",
                    {"lease_id": self._lease_id},
                    body={},
                    timeout_s=self._ttl_s / 3.0,
                    repeatable=False,
                )
                renewed = sent
            except Problem as problem:
                if problem.status not in STATUS_REPEATED or time.monotonic() - renewed > self._ttl_s:
                    self._lost = f"the lease could not be renewed: {problem}"
                    return
            except CoaxisError as error:
                if time.monotonic() - renewed > self._ttl_s:
                    self._lost = f"the lease could not be renewed for {self._ttl_s:g} s: {error}"
                    return


@dataclasses.dataclass(frozen=True)
class _Answer:
    document: Json
    replayed: bool


def _answer(status: int, headers: http.client.HTTPMessage, content: bytes) -> _Answer:
    try:
        document = json.loads(content) if content else {}
    except (ValueError, RecursionError):
        document = None
    if status >= 400:
        # Malformed HTTP is answered without a body, and a proxy in between with a page of its own.
        members = document if isinstance(document, dict) else {}
        raise Problem(status, members, _seconds(headers.get("Retry-After")))
    if not isinstance(document, dict):
        raise AnswerInvalid(f"an answer with status {status} is not a JSON object: {content[:80]!r}")
    return _Answer(document, headers.get("Idempotency-Replayed") == "true")


def _seconds(text: Optional[str]) -> Optional[float]:
    """coaxis sends `Retry-After` in whole seconds; a proxy may send a date, which is ignored."""
    return float(text) if text is not None and text.isascii() and text.isdigit() else None


def _segment(identifier: str) -> str:
    return urllib.parse.quote(identifier, safe="")


def _waits(timeout_s: float, subject: str) -> Iterator[int]:
    """How many seconds each request may wait, until the time is over."""
    end = time.monotonic() + timeout_s
    while True:
        left_s = end - time.monotonic()
        if left_s <= 0.0:
            raise WaitTimeout(f"{subject} had not ended after {timeout_s:g} s; it continues")
        yield max(1, min(int(left_s), WAIT_S_MAX))


def _list(document: Json, key: str) -> Tuple[Json, ...]:
    return tuple(document.get(key) or ())


def _build(kind: Type[T], source: Json, /, **given: Any) -> T:
    """A dataclass from a JSON object. Members that later versions add are ignored; a missing one without a default fails."""
    try:
        members = {
            field.name: source.get(field.name) if _may_be_none(field) else source[field.name]
            for field in dataclasses.fields(kind)  # type: ignore[arg-type]  # every `kind` is a dataclass
            if field.name not in given
        }
        return kind(**members, **given)
    except (KeyError, TypeError, AttributeError) as error:
        raise AnswerInvalid(f"the answer is no {kind.__name__}: {error!r}") from error


def _may_be_none(field: dataclasses.Field[Any]) -> bool:
    return str(field.type).startswith("Optional")


def _reason(document: Json) -> Reason:
    words = ("code", "detail", "text")
    numbers = {key: value for key, value in document.items() if key not in words}
    return Reason(str(document.get("code", "")), str(document.get("detail") or document.get("text") or ""), numbers)


def _part(document: Json, name: Optional[str]) -> Part:
    pose, uncertainty, refusal = document.get("pose"), document.get("uncertainty"), document.get("refusal")
    conditioning = document.get("conditioning") or {}
    return Part(
        name=name,
        verdict=str(document.get("verdict")),
        pose=_build(Pose, pose, document=pose) if pose else None,
        uncertainty=_build(Uncertainty, uncertainty, document=uncertainty) if uncertainty else None,
        profiles=_build(ProfileCounts, document.get("profiles") or {}),
        warnings=tuple(_reason(warning) for warning in _list(conditioning, "warnings")),
        refusal=_reason(refusal) if refusal else None,
    )


def _measurement(answer: _Answer) -> Measurement:
    document = answer.document
    parts = tuple(_part(part, part.get("name")) for part in _list(document, "parts"))
    if not parts and document.get("verdict"):
        parts = (_part(document, None),)
    provenance = document.get("provenance") or {}
    refusal, failure = document.get("refusal"), document.get("failure")
    return _build(
        Measurement,
        document,
        refusal=_reason(refusal) if refusal else None,
        failure=_reason(failure) if failure else None,
        parts=parts,
        recipe_name=provenance.get("recipe_name"),
        scan_sha256=provenance.get("scan_sha256"),
        replayed=answer.replayed,
        document=document,
    )


def _move(answer: _Answer) -> Move:
    ending = answer.document.get("ending")
    return _build(
        Move,
        answer.document,
        ending=_reason(ending) if ending else None,
        replayed=answer.replayed,
        document=answer.document,
    )
