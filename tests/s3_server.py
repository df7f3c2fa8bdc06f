"""A real server that speaks S3, on a folder."""

from __future__ import annotations

import shutil
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path
from types import TracebackType

import httpx
from api_process import free_port


class S3Server:
    """`rclone serve s3`. environment: what its clients need to find it."""

    def __init__(self, folder: Path) -> None:
        (folder / "bucket").mkdir(parents=True)
        self.folder = folder
        self.port = free_port()
        self.environment = {
            "AWS_ENDPOINT_URL": f"http://127.0.0.1:{self.port}",
            "AWS_ACCESS_KEY_ID": "somebody",
            "AWS_SECRET_ACCESS_KEY": "something-secret",
            "AWS_REGION": "us-east-1",
        }

    def __enter__(self) -> S3Server:
        program = shutil.which("rclone") or str(Path(sys.executable).with_name("rclone"))
        keys = ",".join(
            self.environment[f"AWS_{name}"] for name in ("ACCESS_KEY_ID", "SECRET_ACCESS_KEY")
        )
        command = [program, "serve", "s3", str(self.folder), "--auth-key", keys]
        self._process = subprocess.Popen(
            [*command, "--addr", f"127.0.0.1:{self.port}", "--config", "/dev/null"],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        deadline = time.monotonic() + 30
        while time.monotonic() < deadline:
            with suppress(httpx.TransportError):
                httpx.get(self.environment["AWS_ENDPOINT_URL"])
                return self
            time.sleep(0.05)
        raise AssertionError("the S3 server does not come up")

    def stop(self) -> None:
        """End it."""
        self._process.terminate()
        self._process.wait(10)

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, _: TracebackType | None
    ) -> None:
        self.stop()
