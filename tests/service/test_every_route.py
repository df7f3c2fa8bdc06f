"""Every route of the document, walked: closed without a key, blind to what belongs to others."""

from __future__ import annotations

import contextlib
import importlib
import io
import json
import pkgutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest
from api_process import Api, ApiProcess, ball
from websockets.exceptions import ConnectionClosedError, InvalidStatus
from websockets.sync.client import connect

import service.routes
from jobs.ids import new_id
from jobs.records import JobRecords
from jobs.redis_server import EmbeddedRedis
from jobs.settings import Settings
from jobs.spec import JobState
from jobs.store import FileStore
from service import keys

MAIN = "main-key-of-this-service"
DOCUMENT = json.loads(Path(__file__).parents[2].joinpath("docs/openapi.json").read_text())
OPEN = {"/healthz", "/readyz"}  # they tell no secrets; see docs/api.md
METHODS = ("get", "put", "post", "delete", "patch", "head", "options")
ROUTES = [
    (method.upper(), path)
    for path, described in DOCUMENT["paths"].items()
    for method in described
    if method in METHODS
]


@pytest.fixture(scope="module")
def guarded(api_redis: EmbeddedRedis, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Api]:
    folder = tmp_path_factory.mktemp("walked")
    shared = Settings(data=folder / "data", redis_url=f"{api_redis.url}?db=6")
    with ApiProcess(shared, folder / "log", {"UDFLOW_KEY": MAIN}) as running:
        yield running


@pytest.fixture(scope="module")
def tenants(guarded: Api) -> Iterator[dict[str, httpx.Client]]:
    """Two callers and nobody."""
    made = {"nobody": httpx.Client(base_url=guarded.url, timeout=30)}
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("REDIS_URL", guarded.shared.url)
        for name in ("anna", "ben"):
            token = _new_key(name)
            headers = {"Authorization": f"Bearer {token}"}
            made[name] = httpx.Client(base_url=guarded.url, headers=headers, timeout=30)
    yield made
    for client in made.values():
        client.close()


def _new_key(name: str) -> str:
    out = io.StringIO()
    with contextlib.redirect_stdout(out):
        assert keys.main(["add", name]) == 0
    return out.getvalue().strip()


@pytest.fixture(scope="module")
def of_anna(tenants: dict[str, httpx.Client], guarded: Api) -> dict[str, str]:
    """Ids of all that a caller can have: a scan, an upload, and a finished job with files."""
    anna = tenants["anna"]
    scan = anna.post("/v1/scans", files={"file": ("ball.npy", ball())}).json()["id"]
    begun = {"Tus-Resumable": "1.0.0", "Upload-Length": "1000"}
    upload = anna.post("/v1/uploads", headers=begun).headers["location"].rpartition("/")[2]
    job = anna.post("/v1/jobs", json={"scan_id": scan}).json()["id"]
    with guarded.shared.connect() as connection:
        records, store = JobRecords(connection), FileStore(guarded.shared.data)
        records.claim(job, 1)
        names = ("mesh.ply", "points.ply", "report.json", "preview.png", "field.safetensors")
        outputs = {
            name: store.put_artifact(job, 1, name, lambda path: path.write_bytes(b"secret"))
            for name in names
        }
        records.finish(job, 1, JobState.SUCCEEDED, outputs=outputs)
    return {"scan_id": scan, "upload_id": upload, "job_id": job, "name": "vase"}


def ask(client: httpx.Client, method: str, path: str, ids: dict[str, str]) -> httpx.Response:
    headers = {"Tus-Resumable": "1.0.0", "Upload-Offset": "0", "Upload-Length": "10"}
    body: dict[str, Any] = {}
    if method == "PATCH":
        body = {"content": b"x"}
        headers["Content-Type"] = "application/offset+octet-stream"
    elif path.endswith("/udf"):
        body = {"json": {"points": [[0, 0, 0]]}}
    elif method == "POST" and path.startswith("/v1/jobs"):
        body = {"json": {"scan_id": ids["scan_id"]} if path == "/v1/jobs" else {}}
    return client.request(method, path.format(**ids), headers=headers, **body)


def test_the_document_is_the_whole_service() -> None:
    """So that walking it leaves no route out: what is not in it shares its path, or says what can
    be asked by tus."""
    served: set[tuple[str, str]] = set()
    for module in pkgutil.iter_modules(service.routes.__path__):
        router = importlib.import_module(f"service.routes.{module.name}").router
        for route in router.routes:
            methods = getattr(route, "methods", None) or {"websocket"}
            served |= {(method, route.path) for method in methods}
    assert set(ROUTES) <= served
    rest = served - set(ROUTES)
    assert {(method, path) for method, path in rest if method not in ("HEAD", "websocket")} == {
        ("OPTIONS", "/v1/uploads")
    }
    assert {path for _, path in rest} <= set(DOCUMENT["paths"])


@pytest.mark.parametrize(("method", "path"), ROUTES)
def test_without_a_key_every_route_is_closed(
    method: str, path: str, tenants: dict[str, httpx.Client], of_anna: dict[str, str]
) -> None:
    answer = ask(tenants["nobody"], method, path, of_anna)
    assert answer.status_code == (401 if path not in OPEN else answer.status_code)
    assert answer.status_code in (200, 401, 503)
    if answer.status_code == 401 and method != "HEAD":
        assert answer.json()["code"] == "unauthorized"
        assert all(
            one not in answer.text.replace(answer.json()["instance"], "")
            for one in (of_anna["scan_id"], of_anna["job_id"], "secret")
        )


@pytest.mark.parametrize(("method", "path"), [route for route in ROUTES if "_id}" in route[1]])
def test_what_belongs_to_another_is_not_there(
    method: str, path: str, tenants: dict[str, httpx.Client], of_anna: dict[str, str]
) -> None:
    """Answered to the word as an id that never was: nobody learns even that it exists."""
    theirs = ask(tenants["ben"], method, path, of_anna)
    never = {
        "scan_id": new_id("scan"),
        "upload_id": new_id("upload"),
        "job_id": new_id("job"),
        "name": "vase",
    }
    unknown = ask(tenants["ben"], method, path, never)
    assert (theirs.status_code, unknown.status_code) == (404, 404)
    if method != "HEAD":
        assert _anonymous(theirs, of_anna) == _anonymous(unknown, never)


def _anonymous(answer: httpx.Response, ids: dict[str, str]) -> dict[str, Any]:
    text = answer.text
    for name, one in ids.items():
        text = text.replace(one, name)
    values: dict[str, Any] = json.loads(text)
    del values["request_id"]
    return values


def test_afterwards_everything_is_still_there_for_its_owner(
    tenants: dict[str, httpx.Client], of_anna: dict[str, str]
) -> None:
    anna = tenants["anna"]
    assert anna.get(f"/v1/jobs/{of_anna['job_id']}").json()["state"] == "succeeded"
    assert anna.get(f"/v1/jobs/{of_anna['job_id']}/mesh").content == b"secret"
    assert anna.get(f"/v1/scans/{of_anna['scan_id']}").status_code == 200
    assert anna.get(f"/v1/uploads/{of_anna['upload_id']}").json()["offset"] == 0
    for path in ("/v1/jobs", "/v1/jobs?state=succeeded", f"/v1/jobs?scan_id={of_anna['scan_id']}"):
        assert of_anna["job_id"] not in tenants["ben"].get(path).text
        assert of_anna["job_id"] in anna.get(path).text


def test_events_of_another_are_not_told(
    guarded: Api, tenants: dict[str, httpx.Client], of_anna: dict[str, str]
) -> None:
    address = f"{guarded.ws}/v1/jobs/{of_anna['job_id']}/events"
    with pytest.raises(InvalidStatus):
        connect(address)
    ticket = tenants["ben"].post("/v1/tickets").json()["ticket"]
    with (
        connect(f"{address}?ticket={ticket}") as line,
        pytest.raises(ConnectionClosedError, match="4404"),
    ):
        line.recv(10)
    sent = tenants["ben"].get(
        f"/v1/jobs/{of_anna['job_id']}/events", headers={"Accept": "text/event-stream"}
    )
    assert sent.status_code == 404
