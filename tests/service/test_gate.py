"""What every request passes: host, origin, key, request id, headers."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest
from api_process import Api, ApiProcess, ball
from websockets.exceptions import ConnectionClosedError, InvalidStatus
from websockets.sync.client import connect

from jobs.ids import new_id
from jobs.redis_server import EmbeddedRedis
from jobs.settings import Settings
from service.settings import ServiceSettings, SettingsError, from_environment

KEY = "canary-4f1c2d3e5a6b7c8d"


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({}, 200),
        ({"host": "localhost"}, 200),
        ({"host": "LOCALHOST:1234"}, 200),
        ({"host": "[::1]:80"}, 200),
        ({"host": "example.com"}, 421),
        ({"host": "127.0.0.1.example.com"}, 421),
        ({"host": ""}, 421),
        ({"origin": "http://example.com"}, 403),
        ({"origin": "null"}, 403),
    ],
)
def test_hosts_and_origins(headers: dict[str, str], status: int, client: httpx.Client) -> None:
    answer = client.get("/v1/info", headers=headers)
    assert answer.status_code == status
    if status != 200:
        assert answer.headers["content-type"] == "application/problem+json"


def test_the_page_of_the_service_itself_is_welcome(client: httpx.Client) -> None:
    origin = str(client.base_url).rstrip("/")
    assert client.get("/v1/info", headers={"origin": origin}).status_code == 200


def test_other_sites_cannot_upload(client: httpx.Client) -> None:
    files = {"file": ("a.npy", ball())}
    answer = client.post("/v1/scans", files=files, headers={"origin": "http://example.com"})
    assert (answer.status_code, answer.json()["code"]) == (403, "cross_origin")
    assert "access-control-allow-origin" not in answer.headers


def test_request_ids_are_kept_or_made(client: httpx.Client) -> None:
    sent = client.get("/nowhere", headers={"x-request-id": "abc-123"})
    assert sent.headers["x-request-id"] == sent.json()["request_id"] == "abc-123"
    for bad in ("x" * 100, "a b", "<script>"):
        made = client.get("/nowhere", headers={"x-request-id": bad}).headers["x-request-id"]
        assert made != bad
        assert len(made) == 16


@pytest.mark.parametrize("path", ["/healthz", "/nowhere", "/v1/jobs/x"])
def test_security_headers_are_everywhere(path: str, client: httpx.Client) -> None:
    headers = client.get(path).headers
    assert headers["x-content-type-options"] == "nosniff"
    assert headers["x-frame-options"] == "DENY"
    assert "server" not in headers


@pytest.mark.parametrize(
    ("method", "path", "status"),
    [("GET", "/v2/jobs", 404), ("PUT", "/v1/jobs", 405), ("DELETE", "/v1/info", 405)],
)
def test_wrong_addresses_are_problems_too(
    method: str, path: str, status: int, client: httpx.Client
) -> None:
    answer = client.request(method, path)
    assert answer.status_code == status
    assert answer.json()["status"] == status
    assert answer.json()["instance"] == path


@pytest.fixture(scope="module")
def locked(api_redis: EmbeddedRedis, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Api]:
    """An API with a key, as it would be opened to others."""
    folder = tmp_path_factory.mktemp("locked")
    shared = Settings(data=folder / "data", redis_url=api_redis.url)
    with ApiProcess(shared, folder / "log", {"UDFLOW_KEY": KEY}) as running:
        yield running


def test_without_the_key_nothing_is_told(locked: Api) -> None:
    document = httpx.get(f"{locked.url}/openapi.json", headers={"authorization": f"Bearer {KEY}"})
    for path, operations in document.json()["paths"].items():
        for method in operations:
            answer = httpx.request(method, locked.url + path.replace("{", "").replace("}", ""))
            expected = (200, 503) if path in ("/healthz", "/readyz") else (401,)
            assert answer.status_code in expected, (method, path)
    assert httpx.get(f"{locked.url}/openapi.json").status_code == 401


@pytest.mark.parametrize(
    "sent", ["", "Bearer", "Bearer wrong-key-wrong-key", f"Basic {KEY}", f"Bearer {KEY}x", KEY]
)
def test_wrong_keys(sent: str, locked: Api) -> None:
    answer = httpx.get(f"{locked.url}/v1/info", headers={"authorization": sent})
    assert (answer.status_code, answer.json()["code"]) == (401, "unauthorized")
    assert answer.headers["www-authenticate"] == "Bearer"


def test_the_key_opens_websockets_and_any_host(locked: Api) -> None:
    key = {"Authorization": f"Bearer {KEY}"}
    assert httpx.get(f"{locked.url}/v1/info", headers=key | {"Host": "scans.example"}).is_success
    url = f"{locked.ws}/v1/jobs/{new_id('job')}/events"
    with connect(url, additional_headers=key) as socket:
        with pytest.raises(ConnectionClosedError):
            socket.recv(timeout=10)
        assert socket.close_code == 4404
    with pytest.raises(InvalidStatus) as refused, connect(url):
        pass
    assert refused.value.response.status_code == 401


def test_the_key_is_never_written_down(locked: Api) -> None:
    httpx.get(f"{locked.url}/v1/info", headers={"authorization": f"Bearer {KEY}"})
    httpx.post(f"{locked.url}/v1/jobs", headers={"authorization": f"Bearer {KEY}"}, content=b"{")
    assert KEY not in locked.log.read_text()


@pytest.mark.parametrize("host", ["0.0.0.0", "::", "192.168.1.5", "scans.example"])
def test_other_addresses_need_a_key(host: str) -> None:
    with pytest.raises(SettingsError, match="UDFLOW_KEY"):
        from_environment({"UDFLOW_HOST": host})
    assert from_environment({"UDFLOW_HOST": host, "UDFLOW_KEY": KEY}).host == host


@pytest.mark.parametrize("host", ["127.0.0.1", "127.0.1.9", "::1", "localhost"])
def test_this_machine_needs_none(host: str) -> None:
    assert from_environment({"UDFLOW_HOST": host}).key is None


@pytest.mark.parametrize(
    ("name", "value"),
    [("PORT", "eighty"), ("PORT", "0"), ("PORT", "70000"), ("UDFLOW_KEY", "short")],
)
def test_settings_that_cannot_be_used(name: str, value: str) -> None:
    with pytest.raises(SettingsError, match=name):
        from_environment({name: value})


def test_settings_default_to_this_machine() -> None:
    assert from_environment({}) == ServiceSettings(host="127.0.0.1", port=8000)


def test_readiness_names_what_is_missing(client: httpx.Client) -> None:
    answer = client.get("/readyz")
    problem = answer.json()
    assert (answer.status_code, problem["code"]) == (503, "not_ready")
    assert [check["name"] for check in problem["checks"] if not check["ok"]] == ["worker"]
    assert client.get("/healthz").status_code == 200


def test_a_redis_that_is_away_is_no_mystery(tmp_path: Path) -> None:
    server = EmbeddedRedis(tmp_path / "redis")
    server.start()
    shared = Settings(data=tmp_path / "data", redis_url=server.url)
    with ApiProcess(shared, tmp_path / "log", {}) as api:
        scan = httpx.post(f"{api.url}/v1/scans", content=ball(), timeout=30)
        assert scan.status_code == 201
        server.stop()
        body = json.dumps({"scan_id": scan.json()["id"]})
        answer = httpx.post(f"{api.url}/v1/jobs", content=body, timeout=30)
        assert (answer.status_code, answer.json()["code"]) == (503, "queue_unavailable")
        assert "retry-after" in answer.headers
        assert httpx.get(f"{api.url}/readyz", timeout=30).status_code == 503
        assert httpx.get(f"{api.url}/v1/info", timeout=30).status_code == 200
        again = httpx.post(f"{api.url}/v1/scans", content=ball(), timeout=30)
        assert (again.status_code, again.json()["id"]) == (200, scan.json()["id"])
