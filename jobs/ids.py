"""Identifiers: sortable by creation time and not to be guessed.

`job_` + 10 characters of milliseconds since 1970 + 26 characters of 128 random bits, in
Crockford's base 32 (no i, l, o, u). Letters, digits and `_` only, as file names, Redis keys and RQ
demand.
"""

from __future__ import annotations

import re
import secrets
import time
from typing import Literal

from jobs.errors import UnknownId

Kind = Literal["scan", "job", "upload"]

_ALPHABET = "0123456789abcdefghjkmnpqrstvwxyz"
_TIME_CHARACTERS = 10
_RANDOM_CHARACTERS = 26
_PATTERN = re.compile(r"(scan|job|upload)_[0-9a-hjkmnp-tv-z]{36}")


def new_id(kind: Kind, at: float | None = None) -> str:
    """A fresh identifier. at: creation time in Unix seconds, default now."""
    seconds = time.time() if at is None else at
    return first_id(kind, seconds) + _encode(secrets.randbits(128), _RANDOM_CHARACTERS)


def first_id(kind: Kind, at: float) -> str:
    """Text that sorts before every identifier made at Unix second `at` or later."""
    return f"{kind}_{_encode(int(at * 1000), _TIME_CHARACTERS)}"


def is_id(kind: Kind, text: str) -> bool:
    """Whether the text has the form of an identifier of this kind."""
    match = _PATTERN.fullmatch(text)
    return match is not None and match.group(1) == kind


def require_id(kind: Kind, text: str) -> str:
    """The text itself.

    Raises:
        UnknownId: it does not have the form of an identifier of this kind.
    """
    if not is_id(kind, text):
        raise UnknownId(f"there is no such {kind}: the id does not look like {kind}_01h8x...")
    return text


def _encode(number: int, characters: int) -> str:
    digits = [_ALPHABET[(number >> 5 * place) & 31] for place in range(characters)]
    return "".join(reversed(digits))
