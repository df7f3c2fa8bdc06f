"""A client of the service: scans in, meshes and distances out. Needs httpx, never torch.

    from udflow.client import Client

    with Client("http://127.0.0.1:8000") as service:
        job = service.submit("scan.ply", preset="fast")
        service.wait(job["id"], progress=print)
        service.mesh(job["id"], "mesh.glb")
        answer = service.query(job["id"], points, gradients=True)

What is lost on the way is asked for again: requests while the service is away, uploads and
downloads where they broke off, events after the last one seen. Jobs go by their ids, so another
program, or the same one later, can go on with them.
"""

from __future__ import annotations

import base64
import contextlib
import io
import json
import os
import time
import uuid
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import httpx
import numpy as np
from numpy.typing import ArrayLike, NDArray

from udflow.errors import UdflowError

URL = "http://127.0.0.1:8000"
TERMINAL = ("succeeded", "failed", "canceled", "expired")
_CHUNK = 8 << 20  # bytes of an upload sent at a time
_TRIES = 6
_PAUSE_S = 0.5
_TUS = {"Tus-Resumable": "1.0.0"}

Json = dict[str, Any]


class ServiceError(UdflowError):
    """The service refused. code: stable; status: of the answer; problem: all that it said."""

    def __init__(self, problem: Json, status: int) -> None:
        super().__init__(problem.get("detail") or f"the service answered {status}")
        self.code = str(problem.get("code", "unknown"))
        self.status = status
        self.problem = problem


class ServiceAway(UdflowError):
    """The service does not answer."""

    code = "service_away"


class JobEnded(UdflowError):
    """The job ended without a result. job: as it ended."""

    code = "job_ended"

    def __init__(self, job: Json) -> None:
        error = job.get("error") or {}
        super().__init__(f"{job['id']} is {job['state']}: {error.get('message', 'no result')}")
        self.job = job


@dataclass(frozen=True)
class Answer:
    """Distances at n points, in the units and frame of the scan.

    distance: (n,); valid: (n,) whether the point lies in the box that was fitted; gradient: (n, 3)
    unit vectors away from the surface; closest: (n, 3) points of the surface; None if not asked.
    """

    distance: NDArray[np.float64]
    valid: NDArray[np.bool_]
    gradient: NDArray[np.float64] | None = None
    closest: NDArray[np.float64] | None = None


class Client:
    """One service. Methods raise `ServiceError` when it refuses, `ServiceAway` when it is away.

    Args:
        url: its address; default: UDFLOW_URL, else this machine.
        key: default: UDFLOW_KEY, else none.
        timeout_s: for one answer.
    """

    def __init__(
        self, url: str | None = None, key: str | None = None, *, timeout_s: float = 60.0
    ) -> None:
        secret = key or os.environ.get("UDFLOW_KEY")
        headers = {"Authorization": f"Bearer {secret}"} if secret else {}
        address = url or os.environ.get("UDFLOW_URL") or URL
        # results may lie in a bucket; the key is not sent there
        self._http = httpx.Client(
            base_url=address, headers=headers, timeout=timeout_s, follow_redirects=True
        )

    def __enter__(self) -> Client:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Give the connections back."""
        self._http.close()

    # scans and jobs

    def upload(
        self, scan: Path | str | bytes, *, progress: Callable[[int, int], object] | None = None
    ) -> Json:
        """Send a scan in pieces that survive a broken line; its description.

        progress: called with bytes sent and bytes in all.
        """
        with _opened(scan) as (file, name, size):
            metadata = f"filename {base64.b64encode(name.encode()).decode()}"
            headers = _TUS | {"Upload-Length": str(size), "Upload-Metadata": metadata}
            address = self._ask("POST", "/v1/uploads", headers=headers).headers["location"]
            offset, reply = 0, None
            while offset < size or reply is None:
                file.seek(offset)
                reply, offset = self._send_piece(address, offset, file.read(_CHUNK))
                if progress is not None:
                    progress(offset, size)
        return self._json("GET", reply.headers["upload-scan"])

    def scan(self, scan_id: str) -> Json:
        """What is known about a scan."""
        return self._json("GET", f"/v1/scans/{scan_id}")

    def submit(
        self,
        scan: Path | str | bytes | Mapping[str, Any],
        *,
        preset: str = "fast",
        config: Mapping[str, Any] | None = None,
        outputs: Sequence[str] = (),
        metadata: Mapping[str, str] | None = None,
        ttl_s: float | None = None,
        webhook: str | None = None,
    ) -> Json:
        """Start a job; the job as it is then.

        scan: a file, its bytes, or what `upload` gave.
        """
        body = self._wish(scan, preset, config)
        body |= {"outputs": list(outputs), "metadata": dict(metadata or {})}
        body |= {"ttl_s": ttl_s, "webhook": webhook}
        return self._json("POST", "/v1/jobs", json=body, headers=_once())

    def estimate(
        self,
        scan: Path | str | bytes | Mapping[str, Any],
        *,
        preset: str = "fast",
        config: Mapping[str, Any] | None = None,
    ) -> Json:
        """What such a job would take: `seconds` and `memory_bytes` with their bounds."""
        body = self._wish(scan, preset, config)
        told = self._json("POST", "/v1/jobs", json=body, params={"validate_only": True})
        estimate: Json = told["estimate"]
        return estimate

    def job(self, job_id: str, *, wait_s: float = 0.0) -> Json:
        """The job as it is now, or after its end if that comes within wait_s (up to 60)."""
        return self._json("GET", f"/v1/jobs/{job_id}", params={"wait": wait_s})

    def jobs(self, **filters: Any) -> Iterator[Json]:
        """All jobs, newest first. filters: state, scan_id, created_after."""
        cursor: str | None = None
        while True:
            asked = filters | ({"cursor": cursor} if cursor else {})
            page = self._json("GET", "/v1/jobs", params=asked)
            yield from page["jobs"]
            cursor = page["next_cursor"]
            if cursor is None:
                return

    def wait(self, job_id: str, *, progress: Callable[[Json], object] | None = None) -> Json:
        """The job when it has succeeded.

        progress: called with the data of every event.

        Raises:
            JobEnded: it failed, was canceled or expired.
        """
        for event in self.events(job_id):
            if progress is not None:
                progress(event["data"])
        job = self.job(job_id)
        if job["state"] != "succeeded":
            raise JobEnded(job)
        return job

    def events(self, job_id: str, after: str | None = None) -> Iterator[Json]:
        """What happens to the job until its end, each event once, whatever happens to the line.

        The first is a `snapshot`, the job as it is. after: the id of the last event seen before;
        "0-0" for the beginning.
        """
        tries, resumed = 0, False
        while True:
            news = 0
            try:
                for event in self._stream(job_id, after):
                    tries = 0
                    if resumed and event["type"] == "snapshot":
                        continue  # known, unless a gap was told
                    resumed = resumed and event["type"] != "gap"
                    news += event["type"] != "snapshot"
                    after = event["id"]
                    yield event
                    if event["type"] == "end":
                        return
                if news == 0 and self.job(job_id)["state"] in TERMINAL:
                    return  # `after` was the end
            except (httpx.TransportError, ServiceAway) as error:
                if tries == _TRIES:
                    raise ServiceAway(f"the service is away: {error}") from error
            tries, resumed = tries + 1, after is not None
            time.sleep(_PAUSE_S * 2 ** (tries - 1))

    def cancel(self, job_id: str, *, keep_partial: bool = False) -> Json:
        """Stop a job. keep_partial: make a mesh of what is fitted so far."""
        body = {"keep_partial": keep_partial}
        return self._json("POST", f"/v1/jobs/{job_id}/cancel", json=body)

    def retry(self, job_id: str) -> Json:
        """The same job again; the new one."""
        return self._json("POST", f"/v1/jobs/{job_id}/retry", headers=_once())

    def extract(self, job_id: str, **wishes: Any) -> Json:
        """Another mesh of the same field. wishes: resolution, box, extractor, outputs, ..."""
        return self._json("POST", f"/v1/jobs/{job_id}/extract", json=wishes, headers=_once())

    def delete(self, job_id: str, *, force: bool = False) -> None:
        """Remove a job and its files."""
        self._ask("DELETE", f"/v1/jobs/{job_id}", params={"force": force})

    # results

    def mesh(
        self,
        job_id: str,
        target: Path | str,
        format: str | None = None,
        *,
        frame: str | None = None,
    ) -> Path:
        """Download the mesh.

        format: ply, glb, obj or stl; default: the suffix of `target`. frame: "world" or "local",
        which is relative to a shift that the file states; default: whatever the format can hold.
        """
        path = Path(target)
        params = {"format": format or path.suffix.lstrip(".").lower() or "ply"}
        return self.download(job_id, "mesh", path, params | ({"frame": frame} if frame else {}))

    def download(
        self, job_id: str, name: str, target: Path, params: Mapping[str, str] | None = None
    ) -> Path:
        """Download mesh, points, field, report or preview.png to a file, whole or not at all."""
        part = target.with_name(f".{target.name}.part")
        try:
            with part.open("wb") as file:
                self.fetch(job_id, name, file, params)
            part.replace(target)
        finally:
            part.unlink(missing_ok=True)
        return target

    def fetch(
        self, job_id: str, name: str, file: BinaryIO, params: Mapping[str, str] | None = None
    ) -> None:
        """As `download`, into an open file; goes on where a broken line left it."""
        etag, tries = "", 0
        while True:
            have = file.tell()
            headers = {"Range": f"bytes={have}-", "If-Range": etag} if have and etag else {}
            request = self._http.build_request(
                "GET", f"/v1/jobs/{job_id}/{name}", params=params, headers=headers
            )
            try:
                with contextlib.closing(self._http.send(request, stream=True)) as reply:
                    _raise_refusal(reply)
                    etag = reply.headers.get("etag", "")
                    if have and reply.status_code != 206:
                        file.seek(0)
                        file.truncate()
                    for piece in reply.iter_bytes():
                        file.write(piece)
                return
            except httpx.TransportError as error:
                tries = tries + 1 if file.tell() == have else 1
                _pause(tries, error)

    def query(
        self, job_id: str, points: ArrayLike, *, gradients: bool = False, closest: bool = False
    ) -> Answer:
        """Distances from (n, 3) points to the surface, up to 16 million at a time."""
        body = io.BytesIO()
        np.save(body, np.asarray(points, np.float64), allow_pickle=False)
        asked = {"gradients": gradients, "closest": closest, "valid": True}
        headers = {"Content-Type": "application/x-npy", "Accept": "application/x-npy"}
        address = f"/v1/jobs/{job_id}/udf"
        reply = self._ask(
            "POST", address, content=body.getvalue(), params=asked, headers=headers, timeout=None
        )
        rows = np.load(io.BytesIO(reply.content), allow_pickle=False)
        return Answer(
            rows["distance"],
            rows["valid"],
            rows["gradient"] if gradients else None,
            rows["closest"] if closest else None,
        )

    # how

    def _wish(
        self,
        scan: Path | str | bytes | Mapping[str, Any],
        preset: str,
        config: Mapping[str, Any] | None,
    ) -> Json:
        known = scan if isinstance(scan, Mapping) else self.upload(scan)
        return {"scan_id": known["id"], "preset": preset, "config": dict(config or {})}

    def _send_piece(self, address: str, offset: int, piece: bytes) -> tuple[httpx.Response, int]:
        """The answer and the new offset. After a broken line the service says how far it came."""
        headers = _TUS | {
            "Upload-Offset": str(offset),
            "Content-Type": "application/offset+octet-stream",
        }
        for attempt in range(1, _TRIES + 1):
            try:
                reply = self._http.patch(address, content=piece, headers=headers)
                if reply.status_code not in (409, 423, 502, 503, 504):
                    _raise_refusal(reply)
                    return reply, int(reply.headers["upload-offset"])
                _pause(attempt, reply.text)
            except httpx.TransportError as error:
                _pause(attempt, error)
            there = self._ask("HEAD", address, headers=_TUS)
            came = int(there.headers["upload-offset"])
            if came != offset or "upload-scan" in there.headers:
                return there, came
        raise ServiceAway("the upload does not get on; try again later")

    def _stream(self, job_id: str, after: str | None) -> Iterator[Json]:
        headers = {"Accept": "text/event-stream"} | ({"Last-Event-ID": after} if after else {})
        timeout = httpx.Timeout(10.0, read=45.0)  # a heartbeat comes each 15 s
        address = f"/v1/jobs/{job_id}/events"
        with self._http.stream("GET", address, headers=headers, timeout=timeout) as reply:
            _raise_refusal(reply)
            for line in reply.iter_lines():
                if line.startswith("data: "):
                    event: Json = json.loads(line.removeprefix("data: "))
                    yield event

    def _json(self, method: str, address: str, **options: Any) -> Json:
        values: Json = self._ask(method, address, **options).json()
        return values

    def _ask(self, method: str, address: str, **options: Any) -> httpx.Response:
        """One answer. Everything asked here may be asked twice."""
        for attempt in range(1, _TRIES + 1):
            try:
                reply = self._http.request(method, address, **options)
            except httpx.TransportError as error:
                _pause(attempt, error)
                continue
            if reply.status_code in (502, 503, 504) and attempt < _TRIES:
                _pause(attempt, reply.text)
                continue
            _raise_refusal(reply)
            return reply
        raise ServiceAway("the service is away")


def _raise_refusal(reply: httpx.Response) -> None:
    if not reply.is_error:
        return
    reply.read()
    try:
        problem = reply.json()
    except ValueError:
        problem = {}
    raise ServiceError(problem if isinstance(problem, dict) else {}, reply.status_code)


def _pause(attempt: int, reason: object) -> None:
    """Waits longer each time; gives up in the end."""
    if attempt >= _TRIES:
        raise ServiceAway(f"the service does not answer: {reason}")
    time.sleep(_PAUSE_S * 2 ** (attempt - 1))


def _once() -> dict[str, str]:
    """However often the request is sent, one job comes of it."""
    return {"Idempotency-Key": uuid.uuid4().hex}


@contextlib.contextmanager
def _opened(scan: Path | str | bytes) -> Iterator[tuple[BinaryIO, str, int]]:
    """The scan as a file, its name and its size in bytes."""
    if isinstance(scan, bytes):
        yield io.BytesIO(scan), "scan", len(scan)
        return
    path = Path(scan)
    with path.open("rb") as file:
        yield file, path.name, path.stat().st_size
