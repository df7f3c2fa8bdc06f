"""The tus 1.0 protocol's headers: what they say, and what is wrong with them."""

from __future__ import annotations

import base64
import binascii
from email.utils import formatdate

from fastapi import Request

from jobs.uploads import UploadInfo, UploadStore
from service.problems import Problem, invalid

VERSION = "1.0.0"
EXTENSIONS = "creation,creation-with-upload,expiration,termination"
CHUNK_TYPE = "application/offset+octet-stream"
RESUMABLE = {"Tus-Resumable": VERSION}
_MAX_METADATA = 4096


def require_version(request: Request) -> None:
    """Raises a 412 unless the client speaks this version."""
    if request.headers.get("tus-resumable") != VERSION:
        raise Problem(
            "tus_version",
            f"Send the header Tus-Resumable: {VERSION}.",
            headers={"Tus-Version": VERSION},
        )


def header_number(request: Request, name: str) -> int:
    """A header that holds a whole number.

    Raises:
        Problem: 422, it is missing or no such number.
    """
    text = request.headers.get(name, "")
    if not (text.isascii() and text.isdecimal() and len(text) <= 18):
        code = "invalid_value" if text else "missing"
        raise invalid(f"header:{name}", code, f"{name} must be a whole number of bytes")
    return int(text)


def filename_of(metadata: str) -> str:
    """The file's name in an Upload-Metadata header, "" if there is none.

    Raises:
        Problem: 422, the header is malformed.
    """
    if len(metadata) > _MAX_METADATA:
        message = f"Upload-Metadata is longer than {_MAX_METADATA} bytes"
        raise invalid("header:upload-metadata", "invalid_value", message)
    pairs = [pair.strip().partition(" ") for pair in metadata.split(",") if pair.strip()]
    try:
        values = {key: base64.b64decode(value, validate=True) for key, _, value in pairs}
    except (binascii.Error, ValueError) as error:
        message = "Upload-Metadata holds a value that is not base64"
        raise invalid("header:upload-metadata", "invalid_value", message) from error
    return values.get("filename", values.get("name", b"")).decode("utf-8", "replace")


def headers_of(info: UploadInfo, uploads: UploadStore) -> dict[str, str]:
    """Where the upload is and until when it waits."""
    found = {
        **RESUMABLE,
        "Upload-Offset": str(uploads.offset(info)),
        "Upload-Expires": formatdate(uploads.expires_at(info), usegmt=True),
    }
    if info.scan_id is not None:
        found["Upload-Scan"] = f"/v1/scans/{info.scan_id}"
    return found
