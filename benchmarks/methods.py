"""The methods of the benchmark, each a command that turns a cloud into a mesh."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import mls
import peers

CLASSICS = peers.METHODS
METHODS = ("udflow", *CLASSICS, "mls")


@dataclass(frozen=True)
class Settings:
    """What the rows of one table have in common.

    Attributes:
        resolution: cells along the largest extent, of udflow and mls.
        assignments: KEY=VALUE for `udflow reconstruct --set`.
        samples: points drawn from each surface for the sampled measures and exact distances.
        seed: of scans and samples.
    """

    resolution: int = 256
    assignments: tuple[str, ...] = ()
    samples: int = 100_000
    seed: int = 0


def command(method: str, cloud: Path, mesh: Path, settings: Settings, python: str) -> list[str]:
    """The command line of a method; `python` is the one that has Open3D."""
    if method == "mls":
        return [sys.executable, mls.__file__, str(cloud), str(mesh), str(settings.resolution)]
    if method in CLASSICS:
        return [python, peers.__file__, method, str(cloud), str(mesh)]
    line = [sys.executable, "-m", "udflow", "reconstruct", str(cloud), "-o", str(mesh), "--quiet"]
    line += ["--seed", str(settings.seed), "--resolution", str(settings.resolution)]
    for assignment in settings.assignments:
        line += ["--set", assignment]
    return line


def peers_python(named: str | None) -> str:
    """The Python with Open3D: the one named, that of BENCH_PEERS, or this one."""
    return named or os.environ.get("BENCH_PEERS") or sys.executable


def available(wanted: Sequence[str], python: str) -> list[str]:
    """The wanted methods without those of Open3D where it cannot be imported; says so."""
    if not set(wanted) & set(CLASSICS):
        return list(wanted)
    reason = peers.missing(python)
    if reason is None:
        return list(wanted)
    print(reason, file=sys.stderr)
    return [method for method in wanted if method not in CLASSICS]
