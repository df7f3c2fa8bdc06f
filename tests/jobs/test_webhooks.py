"""What may be called, how it is signed, and when it is tried again."""

from __future__ import annotations

import pytest

from jobs.errors import BadSetting
from jobs.webhooks import BACKOFF_S, is_public, next_try, refusal, secret_of, signed_headers, verify

# the example of the Standard Webhooks specification
SECRET = secret_of("whsec_MfKQ9r8GKYqrTwjUPD8ILPZIo2LaLaSw")
ID, SECONDS, BODY = "msg_p5jXN8AQM9LWM0D4loKWxJek", 1614265330, b'{"test": 2432232314}'
SIGNATURE = "v1,g0hM9SsE+OTPJTGt/tmIKtSyZlE3uFJELVlNIOLJ1OE="


def test_signatures_are_those_of_the_specification() -> None:
    headers = signed_headers(SECRET, ID, SECONDS, BODY)
    assert headers["webhook-signature"] == SIGNATURE
    assert verify(SECRET, headers, BODY)
    assert verify(SECRET, headers | {"webhook-signature": f"v1,other {SIGNATURE}"}, BODY)


@pytest.mark.parametrize(
    "changes",
    [
        {"webhook-id": "msg_other"},
        {"webhook-timestamp": str(SECONDS + 1)},
        {"webhook-timestamp": "soon"},
        {"webhook-signature": "v1,AAAA"},
        {"webhook-signature": ""},
    ],
)
def test_whatever_is_changed_breaks_the_signature(changes: dict[str, str]) -> None:
    assert not verify(SECRET, signed_headers(SECRET, ID, SECONDS, BODY) | changes, BODY)
    assert not verify(SECRET, signed_headers(SECRET, ID, SECONDS, BODY), BODY + b" ")


@pytest.mark.parametrize("text", ["", "whsec_", "whsec_AAAA", "whsec_???", "short"])
def test_weak_secrets_are_refused(text: str) -> None:
    with pytest.raises(BadSetting, match="openssl rand"):
        secret_of(text)


@pytest.mark.parametrize(
    "address",
    [
        *("127.0.0.1", "10.1.2.3", "192.168.0.1", "172.16.0.1", "169.254.169.254", "0.0.0.0"),
        *("100.64.0.1", "224.0.0.1", "255.255.255.255", "::1", "::", "fe80::1%eth0", "fd00::1"),
        *("::ffff:127.0.0.1", "::ffff:169.254.169.254", "64:ff9b::7f00:1", "2002:7f00:1::"),
        "2001:0:53aa:64c:0:fbff:fe00:1",
    ],
)
def test_addresses_inside(address: str) -> None:
    assert not is_public(address)


@pytest.mark.parametrize("address", ["8.8.8.8", "2606:4700::1111", "::ffff:8.8.8.8"])
def test_addresses_outside(address: str) -> None:
    assert is_public(address)


@pytest.mark.parametrize(
    "url",
    [
        *("", "x", "http://example.org/", "ftp://example.org/", "https://", "https:///path"),
        *("https://user:secret@example.org/", "https://example.org:22/", "https://exa mple.org/"),
        *("https://example.org/\r\nHost: other", "https://ex\u00e4mple.org", "https://a:b:c/"),
    ],
)
def test_addresses_that_are_refused_by_their_text(url: str) -> None:
    assert refusal(url, ()) is not None


def test_addresses_that_may_be_called() -> None:
    assert refusal("https://example.org/hook?a=b", ()) is None
    assert refusal("http://intranet:9000/hook", ("intranet",)) is None
    assert refusal("ftp://intranet/", ("intranet",)) is not None


def test_tries_come_further_apart_and_end() -> None:
    waits = [next_try(attempt, 0.0) for attempt in range(1, len(BACKOFF_S) + 2)]
    assert waits[-1] is None
    known = [wait for wait in waits if wait is not None]
    assert 4 < known[0] < 7
    assert known[-1] > 8 * 3600
    assert known[:7] == sorted(known[:7])
