"""How the page is built: only when it must be, and never in the way of the service."""

from __future__ import annotations

import importlib.util
import json
import os
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest

WEB = Path(__file__).resolve().parent.parent / "web"


@pytest.fixture(scope="module")
def build() -> ModuleType:
    spec = importlib.util.spec_from_file_location("page_build", WEB / "build.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def sources(tmp_path: Path) -> Path:
    for name in ("src/main.ts", "index.html", "dist/index.html"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text("x")
        os.utime(tmp_path / name, (1000, 1000))
    return tmp_path


def test_a_page_is_current_until_a_source_changes(build: ModuleType, sources: Path) -> None:
    assert build.is_current(sources)
    os.utime(sources / "src" / "main.ts", (2000, 2000))
    assert not build.is_current(sources)


def test_a_missing_page_is_not_current(build: ModuleType, sources: Path) -> None:
    (sources / "dist" / "index.html").unlink()
    assert not build.is_current(sources)


@pytest.mark.parametrize(("version", "enough"), [("v20.19.0", True), ("v18.20.1", False)])
def test_an_old_node_does_not_count(
    build: ModuleType, tmp_path: Path, version: str, enough: bool
) -> None:
    for name in ("node", "npm"):
        (tmp_path / name).write_text(f"#!/bin/sh\necho {version}\n")
        (tmp_path / name).chmod(0o755)
    assert build.is_new_enough({"PATH": str(tmp_path)}) is enough


def test_no_node_at_all_does_not_count(build: ModuleType, tmp_path: Path) -> None:
    assert not build.is_new_enough({"PATH": str(tmp_path)})


def test_without_node_and_registry_it_says_so_and_ends_well(tmp_path: Path) -> None:
    environment = {"PATH": str(tmp_path), "PIP_NO_INDEX": "1"}
    copy = tmp_path / "web"
    copy.mkdir()
    (copy / "build.py").write_text((WEB / "build.py").read_text())
    answer = subprocess.run(
        [sys.executable, copy / "build.py", "check"],
        env=environment,
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    )
    assert answer.returncode == 0
    assert "NOT checked" in answer.stderr


def test_an_unknown_wish_is_refused(build: ModuleType) -> None:
    assert build.main(["bake"]) == 2


def test_every_package_is_pinned_exactly() -> None:
    package = json.loads((WEB / "package.json").read_text())
    wanted = package["dependencies"] | package["devDependencies"]
    assert all(version[0].isdigit() for version in wanted.values()), wanted
    lock = json.loads((WEB / "package-lock.json").read_text())["packages"]
    for name, version in wanted.items():
        assert lock[f"node_modules/{name}"]["version"] == version
    assert all("integrity" in entry for path, entry in lock.items() if path)
