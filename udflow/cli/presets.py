"""`udflow presets`: the presets and all their parameters."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator
from typing import Any

from udflow.cli.files import print_json
from udflow.config import presets, to_dict


def run(options: argparse.Namespace) -> None:
    """List the presets."""
    known = {name: to_dict(config) for name, config in presets().items()}
    if options.json:
        print_json(known)
        return
    for name, values in known.items():
        sys.stdout.write(f"{name}\n")
        for key, value in _flat(values, ""):
            sys.stdout.write(f"  {key}={json.dumps(value)}\n")


def _flat(values: dict[str, Any], path: str) -> Iterator[tuple[str, Any]]:
    """Dotted keys, as --set takes them."""
    for key, value in values.items():
        if isinstance(value, dict):
            yield from _flat(value, f"{path}{key}.")
        elif key != "preset":
            yield f"{path}{key}", value
