"""Simulated scans over HTTP."""

from __future__ import annotations

import httpx
import pytest


def test_samples_are_listed_with_their_files(client: httpx.Client) -> None:
    samples = client.get("/v1/samples").json()["samples"]
    assert [found["name"] for found in samples] == ["vase", "shirt", "gear", "shells"]
    file = client.get(samples[0]["url"])
    assert file.headers["content-type"] == "application/x-ply"
    assert f"element vertex {samples[0]['points']}".encode() in file.content[:500]
    known = {"If-None-Match": file.headers["etag"]}
    assert client.get(samples[0]["url"], headers=known).status_code == 304


@pytest.mark.parametrize("name", ["vase", "gear"])
def test_a_sample_becomes_a_scan_once(client: httpx.Client, name: str) -> None:
    first = client.post(f"/v1/samples/{name}")
    again = client.post(f"/v1/samples/{name}")
    uploaded = client.post("/v1/scans", content=client.get(f"/v1/samples/{name}").content)
    assert [first.status_code, again.status_code, uploaded.status_code] == [201, 200, 200]
    assert first.json()["id"] == again.json()["id"] == uploaded.json()["id"]
    assert first.headers["location"] == f"/v1/scans/{first.json()['id']}"
    assert first.json()["filename"] == f"{name}.ply"
    assert first.json()["has_colors"] == (name == "vase")


@pytest.mark.parametrize("method", ["GET", "POST"])
def test_an_unknown_sample_is_named_with_the_known_ones(client: httpx.Client, method: str) -> None:
    answer = client.request(method, "/v1/samples/teapot")
    assert answer.status_code == 404
    assert answer.json()["code"] == "sample_not_found"
    assert "vase" in answer.json()["detail"]
