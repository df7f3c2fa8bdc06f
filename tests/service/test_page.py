"""The page's files: types, caching, encodings, policy, and what is said where they are missing."""

from __future__ import annotations

import asyncio
import gzip
import json
from pathlib import Path
from typing import Any

import httpx
import pytest
from fastapi import FastAPI

from service import page, problems
from service.gate import Gate
from service.page import load_page
from service.settings import ServiceSettings


@pytest.fixture
def dist(tmp_path: Path) -> Path:
    (tmp_path / "assets").mkdir()
    (tmp_path / "index.html").write_text("<!doctype html><title>udflow</title>")
    (tmp_path / "assets" / "main-1a2b.js").write_text("export const answer = 42;")
    (tmp_path / "assets" / "main-1a2b.js.br").write_bytes(b"brotli, as far as the server knows")
    (tmp_path / "assets" / "notes.txt").write_text("not part of the page")
    return tmp_path


class Site:
    """Asks the application without a socket between."""

    def __init__(self, app: FastAPI) -> None:
        self._app = app

    def get(self, path: str, method: str = "GET", **headers: str) -> httpx.Response:
        return asyncio.run(self._ask(method, path, headers))[0]

    def raw(self, path: str, **headers: str) -> tuple[httpx.Response, bytes]:
        """The answer and its body as it went over the wire."""
        return asyncio.run(self._ask("GET", path, headers))

    async def _ask(
        self, method: str, path: str, headers: dict[str, Any]
    ) -> tuple[httpx.Response, bytes]:
        transport = httpx.ASGITransport(self._app)
        named = {name.replace("_", "-"): value for name, value in headers.items()}
        async with (
            httpx.AsyncClient(transport=transport, base_url="http://robot.local") as client,
            client.stream(method, f"/tools/udflow{path}", headers=named) as answer,
        ):
            body = b"".join([piece async for piece in answer.aiter_raw()])
        return answer, body


@pytest.fixture
def site(dist: Path, monkeypatch: pytest.MonkeyPatch) -> Site:
    """The page behind the gate, under a path prefix."""
    monkeypatch.setattr(page, "_page", lambda: load_page(dist))
    app, outside = FastAPI(openapi_url=None, redirect_slashes=False), FastAPI(openapi_url=None)
    problems.install(app)
    app.include_router(page.router)
    app.add_middleware(Gate, settings=ServiceSettings(allowed_hosts=("robot.local",)))
    outside.mount("/tools/udflow", app)
    return Site(outside)


def test_the_document_is_asked_for_again_each_time(site: Site) -> None:
    answer = site.get("/")
    assert answer.status_code == 200
    assert answer.headers["content-type"] == "text/html; charset=utf-8"
    assert answer.headers["cache-control"] == "no-cache"
    assert site.get("/", if_none_match=answer.headers["etag"]).status_code == 304
    assert site.get("/", "HEAD").headers["etag"] == answer.headers["etag"]


def test_assets_are_kept_for_ever(site: Site) -> None:
    answer, body = site.raw("/assets/main-1a2b.js", accept_encoding="identity")
    assert body == b"export const answer = 42;"
    assert answer.headers["content-type"] == "text/javascript; charset=utf-8"
    assert answer.headers["cache-control"] == "public, max-age=31536000, immutable"
    assert "content-encoding" not in answer.headers


@pytest.mark.parametrize(
    ("accepted", "coding"), [("gzip, br", "br"), ("gzip;q=0.5", "gzip"), ("zstd", None)]
)
def test_the_best_coding_that_is_accepted_is_sent(
    site: Site, accepted: str, coding: str | None
) -> None:
    answer, body = site.raw("/assets/main-1a2b.js", accept_encoding=accepted)
    assert answer.headers.get("content-encoding") == coding
    assert answer.headers["vary"] == "Accept-Encoding"
    if coding == "br":
        assert body == b"brotli, as far as the server knows"
    else:
        assert (gzip.decompress(body) if coding else body) == b"export const answer = 42;"


def test_codings_have_validators_of_their_own(site: Site) -> None:
    tags = {
        site.get("/assets/main-1a2b.js", accept_encoding=coding).headers["etag"]
        for coding in ("gzip", "identity")
    }
    assert len(tags) == 2


def test_nothing_may_be_loaded_from_elsewhere(site: Site) -> None:
    policy = site.get("/").headers["content-security-policy"]
    rules = dict(rule.split(" ", 1) for rule in policy.split("; "))
    assert rules["default-src"] == "'none'"
    assert rules["script-src"] == rules["style-src"] == rules["connect-src"] == "'self'"
    assert rules["frame-ancestors"] == "'none'"
    assert "unsafe" not in policy
    assert "http" not in policy


@pytest.mark.parametrize(
    ("path", "is_open"),
    [
        ("/", True),
        ("/favicon.svg", True),
        ("/assets/main-1a2b.js", True),
        ("/v1/jobs", False),
        ("/openapi.json", False),
        ("/assetsx", False),
    ],
)
def test_only_the_page_is_open_where_a_key_is_needed(path: str, is_open: bool) -> None:
    assert page.is_open(path) is is_open


@pytest.mark.parametrize("name", ["notes.txt", "main-1a2b.js.br", "..%2Findex.html", "gone.js"])
def test_other_files_are_not_served(site: Site, name: str) -> None:
    answer, body = site.raw(f"/assets/{name}")
    assert answer.status_code == 404
    assert json.loads(body)["code"] == "not_found"


def test_a_page_that_was_not_built_says_how_to_build_it(
    site: Site, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(page, "_page", lambda: load_page(tmp_path / "assets"))
    answer, body = site.raw("/")
    assert answer.status_code == 200
    assert b"npm run build" in body
    assert b"openapi.json" in body
