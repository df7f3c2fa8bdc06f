"""Exit code 0 while the API of this container answers, else 1 and why. Needs no key."""

from __future__ import annotations

import os
import sys
import urllib.error
import urllib.request


def main() -> str | None:
    """What is wrong, or None."""
    url = f"http://127.0.0.1:{os.environ.get('PORT') or 8000}/healthz"
    try:
        with urllib.request.urlopen(url, timeout=4):
            return None
    except (OSError, urllib.error.URLError) as error:
        return f"{url}: {error}"


if __name__ == "__main__":
    sys.exit(main())
