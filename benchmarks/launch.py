"""Runs a command and prints what it took, as JSON: `launch.py LIMIT_S COMMAND ...`.

The kernel counts the memory of whoever starts a process as that process's own peak. A benchmark
that holds meshes would lend its size to each small method, so this small program stands between.
"""

import json
import os
import subprocess
import sys
import threading
import time


def main(limit_s: float, command: list[str]) -> None:
    """Run, wait, print; past the limit the command is ended."""
    start = time.monotonic()
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    overdue = threading.Timer(limit_s, process.kill)
    overdue.start()
    _, status, usage = os.wait4(process.pid, 0)
    overdue.cancel()
    kilobytes = usage.ru_maxrss / (1024 if sys.platform == "darwin" else 1)
    took = {
        "code": os.waitstatus_to_exitcode(status),
        "seconds": time.monotonic() - start,
        "processor_s": usage.ru_utime + usage.ru_stime,
        "peak_mb": kilobytes / 1024,
    }
    print(json.dumps(took))


if __name__ == "__main__":
    main(float(sys.argv[1]), sys.argv[2:])
