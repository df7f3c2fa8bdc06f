"""What `reconstruct` and `densify` share: options to config, scan to reconstruction."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from udflow.cli.exits import UsageError
from udflow.cli.files import STREAM, opened_input
from udflow.cli.progress import shown_progress
from udflow.config import Config, from_dict, require_target

if TYPE_CHECKING:
    from udflow.reconstruct import Reconstruction


def config_from(options: argparse.Namespace) -> Config:
    """The preset, then the options of their own, then every --set.

    Raises:
        InvalidConfig: an unknown parameter or a value out of range.
        UsageError: a --set without "=".
    """
    values: dict[str, Any] = {"preset": options.preset, "seed": options.seed}
    if getattr(options, "resolution", None) is not None:
        values["extract"] = {"resolution": options.resolution}
    if getattr(options, "target", None) is not None:
        values["densify"] = {"target_points": options.target}
    for assignment in options.set:
        _assign(values, assignment)
    return from_dict(values)


def checked_device(name: str) -> str:
    """A torch device that this machine has; "auto" takes a GPU where there is one.

    Raises:
        UsageError: there is no such device here.
    """
    if name == "cpu":
        return name
    import torch

    if name == "auto":
        return "cuda" if torch.cuda.is_available() else "cpu"
    try:
        torch.empty(1, device=name)
    except (RuntimeError, AssertionError) as error:  # torch asserts that CUDA was compiled in
        reason = str(error).splitlines()[0]
        raise UsageError(f'cannot use device "{name}": {reason}; try --device cpu') from error
    return name


def fitted(options: argparse.Namespace, config: Config) -> Reconstruction:
    """Read the scan and reconstruct it, showing progress."""
    device = checked_device(options.device)
    from udflow.cloud.formats import read_cloud
    from udflow.cloud.inspection import require_reconstructable
    from udflow.reconstruct import reconstruct

    with opened_input(options.scan) as path:
        cloud = read_cloud(path)
        require_reconstructable(cloud)
        require_target(config, len(cloud.points))
        if getattr(options, "target", None) is not None:
            config.densify.require_above(len(cloud.points))
    checkpoint = getattr(options, "checkpoint", None)
    with shown_progress(options.quiet) as listener:
        return reconstruct(
            cloud,
            config,
            device=device,
            on_progress=listener,
            checkpoint=None if checkpoint is None else Path(checkpoint),
        )


def say(options: argparse.Namespace, lines: list[str]) -> None:
    """The summary for people: on stdout, or on stderr where stdout carries a result."""
    if options.quiet or options.json:
        return
    stream = sys.stderr if options.output == STREAM else sys.stdout
    stream.write("".join(f"{line}\n" for line in lines))


def check_streams(options: argparse.Namespace, *outputs: str | None) -> None:
    """Standard output can carry one thing only."""
    if options.json and STREAM in outputs:
        raise UsageError("--json and a result both want standard output; give a file name for one")


def _assign(values: dict[str, Any], assignment: str) -> None:
    """Put "a.b=value" into nested values; the value is JSON, or else a plain word."""
    key, equals, text = assignment.partition("=")
    if not key or not equals:
        raise UsageError(f'--set "{assignment}" has no value; write --set key=value')
    try:
        value = json.loads(text)
    except json.JSONDecodeError:
        value = text
    *path, last = key.split(".")
    for part in path:
        inner = values.setdefault(part, {})
        if not isinstance(inner, dict):
            raise UsageError(f'--set "{assignment}": {part} holds no parameters')
        values = inner
    values[last] = value
