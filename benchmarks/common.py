"""What every benchmark needs: data, provenance, cold processes, tables."""

from __future__ import annotations

import json
import os
import platform
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from udflow.mesh.load import read_mesh
from udflow.mesh.mesh import Mesh
from udflow.metrics.surface import bounds, sample

ROOT = Path(__file__).resolve().parent.parent
DATA = ROOT.parent / "shared" / "data"
RESULTS = ROOT / "docs" / "results"
LAUNCHER = Path(__file__).with_name("launch.py")
FOLDERS = ("closed", "cad", "open", "layered")


@dataclass(frozen=True)
class Finished:
    """A process that ended.

    Attributes:
        seconds: wall time from its start to its end.
        processor_s: seconds of all its threads; other load on the machine changes them little.
        peak_mb: largest resident memory.
        errors: what it said there.
    """

    code: int
    seconds: float
    processor_s: float
    peak_mb: float
    errors: str


def shapes(data: Path, wanted: Sequence[str]) -> list[tuple[str, Path]]:
    """(folder/name, file) of the ground-truth meshes, all or those whose name is wanted."""
    found = [
        (f"{folder}/{file.stem}", file)
        for folder in FOLDERS
        for file in sorted((data / folder).glob("*"))
    ]
    if not found:
        raise SystemExit(f"no meshes under {data}; point --data at the folder with the shapes")
    names = {name for name, _ in found} | {name.split("/")[1] for name, _ in found}
    if unknown := set(wanted) - names:
        raise SystemExit(f"no shape called {', '.join(sorted(unknown))}")
    return [
        (name, file)
        for name, file in found
        if not wanted or name in wanted or name.split("/")[1] in wanted
    ]


def load(file: Path) -> Mesh:
    """A ground-truth mesh as it is in its file, node transforms applied."""
    return read_mesh(file)


def scan_of(mesh: Mesh, points: int, noise: float, seed: int) -> NDArray[np.float64]:
    """(points, 3) evenly by area, with Gaussian noise of `noise` times the largest extent."""
    generator = np.random.default_rng(seed)
    found = sample(mesh, points, generator).points
    return found + generator.normal(0.0, noise * bounds(mesh)[1], found.shape)


def cold(command: Sequence[str], limit_s: float = 86_400.0) -> Finished:
    """Run a command in a fresh process and measure it from outside; past the limit it is ended."""
    launcher = [sys.executable, "-S", str(LAUNCHER), str(limit_s), *command]
    done = subprocess.run(launcher, capture_output=True, text=True, check=False, cwd=ROOT)
    return Finished(errors=done.stderr, **json.loads(done.stdout))


def provenance(**settings: Any) -> dict[str, Any]:
    """Machine, commit, versions and settings of a run."""
    return {
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "commit": _commit(),
        "machine": {
            "processor": _processor(),
            "cores": os.cpu_count(),
            "memory_gb": round(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30, 1),
            "load_before": round(os.getloadavg()[0], 2),
            "system": platform.system(),
            "python": platform.python_version(),
        },
        "versions": {name: _version(name) for name in ("udflow", "torch", "numpy", "scipy")},
        "settings": settings,
    }


def provenance_line(values: dict[str, Any]) -> str:
    """The same in a sentence, to stand under a table."""
    machine = values["machine"]
    return (
        f"{values['date']}, commit {values['commit']}, {machine['processor']}, "
        f"{machine['cores']} cores, load {machine['load_before']} before the run, "
        f"Python {machine['python']}, torch {values['versions']['torch']}. "
        f"Settings: {json.dumps(values['settings'])}."
    )


def markdown(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table in Markdown."""
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines) + "\n"


def save(name: str, values: dict[str, Any], text: str) -> None:
    """Write docs/results/<name>.json and .md."""
    RESULTS.mkdir(parents=True, exist_ok=True)
    (RESULTS / f"{name}.json").write_text(json.dumps(values, indent=2) + "\n")
    (RESULTS / f"{name}.md").write_text(text)
    print(f"wrote {(RESULTS / name).relative_to(ROOT)}.json and .md")


def _commit() -> str:
    """The commit; "-dirty" where something other than results differs from it."""
    commit = _git("describe", "--always", "--abbrev=12")
    changed = _git("status", "--porcelain", "--untracked-files=no", "--", ".", ":!docs/results")
    return f"{commit}{'-dirty' if changed else ''}" if commit else "not in a repository"


def _git(*arguments: str) -> str:
    command = ["git", *arguments]
    found = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    return found.stdout.strip()


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor()
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.machine()


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed"
