"""The API as a process of its own, for tests that use it as a user would."""

from __future__ import annotations

import io
import os
import socket
import subprocess
import sys
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx
import numpy as np

from jobs.settings import Settings

ROOT = Path(__file__).resolve().parents[1]


@dataclass(frozen=True)
class Api:
    """A running API process. url: "http://127.0.0.1:port"; log: what it has written."""

    url: str
    shared: Settings
    log: Path

    @property
    def ws(self) -> str:
        return self.url.replace("http:", "ws:")


def free_port() -> int:
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        port: int = listener.getsockname()[1]
        return port


@dataclass
class ApiProcess:
    """Starts and stops `python -m service.serve`."""

    shared: Settings
    log: Path
    environment: dict[str, str]

    def __enter__(self) -> Api:
        port = free_port()
        environment = {
            **os.environ,
            "PORT": str(port),
            "REDIS_URL": self.shared.url,
            "UDFLOW_DATA": str(self.shared.data),
            "OMP_NUM_THREADS": "1",
            **self.environment,
        }
        with self.log.open("wb") as log:
            command = [sys.executable, "-m", "service.serve"]
            self._process = subprocess.Popen(command, cwd=ROOT, env=environment, stderr=log)
        api = Api(f"http://127.0.0.1:{port}", self.shared, self.log)
        wait_until_up(api.url, self._process)
        return api

    def __exit__(self, *_: object) -> None:
        self._process.terminate()
        self._process.wait(15)


def wait_until_up(
    url: str, process: subprocess.Popen[bytes], path: str = "/healthz", seconds: float = 60
) -> None:
    deadline = time.monotonic() + seconds
    while True:
        assert process.poll() is None, "the process ended before it was up"
        assert time.monotonic() < deadline, "it does not come up"
        with suppress(httpx.TransportError):
            if httpx.get(url + path).status_code == 200:
                return
        time.sleep(0.05)


def ball(points: int = 500) -> bytes:
    """A sphere of radius 1 as .npy."""
    normal = np.random.default_rng(0).normal(size=(points, 3))
    return npy(normal / np.linalg.norm(normal, axis=1, keepdims=True))


def npy(array: Any) -> bytes:
    file = io.BytesIO()
    np.save(file, array)
    return file.getvalue()
