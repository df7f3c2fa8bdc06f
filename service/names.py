"""File names of users are metadata: cleaned on arrival, never part of a path."""

from __future__ import annotations

import unicodedata

MAX_NAME_BYTES = 255


def clean_filename(name: str) -> str:
    """The last component of `name`, NFC, without control and format characters, 255 bytes.

    Format characters (category Cf) include the bidirectional marks that make "gpj.exe" out of
    "exe.jpg".
    """
    last = name.replace("\\", "/").rsplit("/", 1)[-1]
    kept = "".join(
        character
        for character in unicodedata.normalize("NFC", last)
        if unicodedata.category(character) not in ("Cc", "Cf", "Cs", "Co", "Cn", "Zl", "Zp")
    )
    return _within(kept.strip(), MAX_NAME_BYTES).strip()


def _within(name: str, limit: int) -> str:
    """At most `limit` bytes of UTF-8, cut from the stem so that a short suffix survives."""
    if len(name.encode()) <= limit:
        return name
    stem, dot, suffix = name.rpartition(".")
    if not dot or len(suffix) > 16:
        stem, dot, suffix = name, "", ""
    room = limit - len((dot + suffix).encode())
    return stem.encode()[:room].decode("utf-8", "ignore") + dot + suffix


def stem(name: str) -> str:
    """The name without its last suffix, or "scan" if nothing is left."""
    return name.rpartition(".")[0] or name or "scan"
