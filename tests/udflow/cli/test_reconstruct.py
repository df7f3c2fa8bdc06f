"""`udflow reconstruct` as a user or a script meets it."""

from __future__ import annotations

import io
import json
import os
import pty
import resource
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh
from command_line import QUICK, RADIUS, UDFLOW, off_sphere, run

from udflow.cli import main
from udflow.cloud.formats import read_cloud
from udflow.mesh.load import read_mesh


def test_reconstruct_writes_every_output_in_the_frame_of_the_scan(made: Path) -> None:
    mesh = read_mesh(made / "mesh.ply")
    assert off_sphere(mesh.vertices).max() < 0.02 * RADIUS
    assert len(read_cloud(made / "points.ply").points) == 2_000
    report = json.loads((made / "r.json").read_text())
    assert report["config"]["extract"]["resolution"] == 32
    assert report["points"]["unique"] == 2_000
    names = {path.name for path in made.iterdir()}
    assert names == {"scan.npy", "mesh.ply", "f.safetensors", "r.json", "points.ply"}


def test_the_same_seed_gives_the_same_file(made: Path, scan: str, tmp_path: Path) -> None:
    assert main(["reconstruct", scan, "-o", str(tmp_path / "again.ply"), *QUICK, "--quiet"]) == 0
    assert (tmp_path / "again.ply").read_bytes() == (made / "mesh.ply").read_bytes()


def test_progress_goes_to_stderr_and_the_summary_to_stdout(
    scan: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    assert main(["reconstruct", scan, "-o", str(tmp_path / "mesh.glb"), *QUICK]) == 0
    summary, progress = capfd.readouterr()
    for stage in ("reading", "fitting", "extracting", "exporting"):
        assert stage in progress
    assert "\x1b" not in progress  # no bar where nobody looks
    assert "vertices" in summary
    assert "2000 read" in summary
    assert read_mesh(tmp_path / "mesh.glb").faces.shape[1] == 3


def test_a_terminal_gets_a_bar(scan: str, tmp_path: Path) -> None:
    master, slave = pty.openpty()
    command = [*UDFLOW, "reconstruct", scan, "-o", str(tmp_path / "m.stl"), *QUICK]
    with subprocess.Popen(command, stderr=slave, stdout=subprocess.DEVNULL) as process:
        os.close(slave)
        shown = b""
        while process.poll() is None or len(shown) == 0:
            try:
                shown += os.read(master, 65536)
            except OSError:  # the other end is closed
                break
    os.close(master)
    assert process.returncode == 0, shown.decode()
    assert b"%" in shown
    assert b"\x1b[" in shown


def test_streams_in_and_out(scan: str) -> None:
    done = run("reconstruct", "-", "-o", "-", *QUICK, input=Path(scan).read_bytes())
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith(b"ply\n")
    assert b"vertices" in done.stderr  # the summary makes room for the mesh
    mesh = trimesh.load(io.BytesIO(done.stdout), file_type="ply", process=False)
    assert off_sphere(np.asarray(mesh.vertices)).max() < 0.02 * RADIUS


def test_json_summary(scan: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    mesh = tmp_path / "mesh.ply"
    assert main(["reconstruct", scan, "-o", str(mesh), *QUICK, "--quiet", "--json"]) == 0
    summary = json.loads(capsys.readouterr().out)
    assert summary["faces"] == len(read_mesh(mesh).faces)
    assert summary["report"]["config"]["seed"] == 0


def test_set_wins_over_other_options(scan: str, tmp_path: Path) -> None:
    report = tmp_path / "r.json"
    outputs = ["-o", str(tmp_path / "m.ply"), "--report", str(report), "--quiet"]
    assert main(["reconstruct", scan, *outputs, *QUICK, "--set", "extract.resolution=24"]) == 0
    assert json.loads(report.read_text())["config"]["extract"]["resolution"] == 24


def test_nothing_is_overwritten_without_force(
    scan: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    kept = tmp_path / "kept.ply"
    kept.write_text("mine")
    assert main(["reconstruct", scan, "-o", str(tmp_path / "a.ply"), "--points", str(kept)]) == 2
    assert "kept.ply exists" in capsys.readouterr().err
    assert kept.read_text() == "mine"
    assert list(tmp_path.iterdir()) == [kept]
    assert main(["reconstruct", scan, "-o", str(kept), *QUICK, "--quiet", "--force"]) == 0
    assert kept.read_bytes().startswith(b"ply")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["-o", "mesh.doc"], "cannot tell the format"),
        (["-o", "nowhere/mesh.ply"], "does not exist; create it"),
        (["-o", ".", "--format", "ply"], "is a folder"),
        (["-o", "/dev/null", "--format", "ply", "--force"], "device or pipe"),
        (["-o", "m.ply", "--points", "m.ply"], "two outputs"),
        (["-o", "-", "--json"], "both want standard output"),
        (["-o", "m.ply", "--preset", "finest"], 'unknown preset "finest"; choose one of'),
        (["-o", "m.ply", "--resolution", "100000"], "choose 16 to"),
        (["-o", "m.ply", "--set", "extract.colour=red"], 'unknown parameter "extract.colour"'),
        (["-o", "m.ply", "--set", "extract.resolution=fine"], "must be a whole number"),
        (["-o", "m.ply", "--set", "seed"], "write --set key=value"),
        (["-o", "m.ply", "--set", "seed.deep=1"], "holds no parameters"),
        (["-o", "m.ply", "--device", "abacus"], 'cannot use device "abacus"'),
    ],
)
def test_wrong_options_are_told_in_words_before_any_work(
    arguments: list[str],
    words: str,
    scan: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["reconstruct", scan, *arguments]) == 2
    error = capsys.readouterr().err
    assert error.startswith("udflow: error: ")
    assert words in error
    assert "Traceback" not in error
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(torch.cuda.is_available(), reason="this machine has the device")
def test_a_missing_gpu_is_told_and_auto_does_without(
    scan: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    mesh = str(tmp_path / "m.ply")
    assert main(["reconstruct", scan, "-o", mesh, *QUICK, "--device", "cuda"]) == 2
    assert "try --device cpu" in capsys.readouterr().err
    assert main(["reconstruct", scan, "-o", mesh, *QUICK, "--device", "auto", "--quiet"]) == 0


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (None, "no such file"),
        (b"", "empty"),
        (b"PK\x03\x04 certainly not a scan", "scan.ply"),
        (b"0 0 0\n1 0 0\n0 1 0\n", "100"),
        (b"7 7 7\n" * 200, "all points are equal"),
    ],
)
@pytest.mark.parametrize("command", [["inspect"], ["reconstruct", "-o", "mesh.ply"]])
def test_bad_scans_are_named_with_the_reason(
    content: bytes | None,
    words: str,
    command: list[str],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    if content is not None:
        Path("scan.ply").write_bytes(content)
    assert main([*command, "scan.ply"]) == 3
    error = capsys.readouterr().err
    assert error.startswith("udflow: error: scan.ply: ")
    assert words in error
    assert not Path("mesh.ply").exists()


@pytest.mark.parametrize(
    ("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)], ids=["ctrl-c", "kill"]
)
def test_a_signal_ends_it_at_once_without_a_trace(
    number: signal.Signals, code: int, scan: str, tmp_path: Path
) -> None:
    many = ["--set", "densify.target_points=20000", "--set", "densify.points_per_round=100"]
    (tmp_path / "tmp").mkdir()
    command = [*UDFLOW, "reconstruct", "-", "-o", str(tmp_path / "mesh.ply"), *QUICK, *many]
    environment = {**os.environ, "TMPDIR": str(tmp_path / "tmp")}
    with (
        open(scan, "rb") as points,
        subprocess.Popen(
            command,
            stdin=points,
            stderr=subprocess.PIPE,
            text=True,
            env=environment,
            # tests that run behind nohup or & have it ignored, and children inherit that
            preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
        ) as process,
    ):
        assert process.stderr is not None
        said = ""
        while "fitting" not in said:
            said = process.stderr.readline()
            assert said, "it ended before it could be interrupted"
        process.send_signal(number)
        rest = process.stderr.read()
    assert process.returncode == code
    assert rest.endswith("udflow: error: interrupted; no output is half written\n")
    assert "Traceback" not in rest
    assert [path for path in tmp_path.rglob("*") if path.is_file()] == []


def test_a_signal_that_the_caller_ignores_stays_ignored(scan: str, tmp_path: Path) -> None:
    code = (
        "import signal, sys; signal.signal(signal.SIGINT, signal.SIG_IGN);"
        "from udflow.cli import main; sys.argv[1:] = ['presets']; main();"
        "sys.exit(signal.getsignal(signal.SIGINT) is not signal.SIG_IGN)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_a_disk_that_refuses_leaves_no_half_file(scan: str, tmp_path: Path) -> None:
    """A limit on the size of files stands for a full disk."""
    mesh = tmp_path / "mesh.ply"

    def limit() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))

    done = run("reconstruct", scan, "-o", str(mesh), *QUICK, preexec_fn=limit)
    assert done.returncode == 6
    assert b"cannot write" in done.stderr
    assert b"file too large" in done.stderr
    assert list(tmp_path.iterdir()) == []


def test_a_reader_that_has_seen_enough_is_no_error() -> None:
    with subprocess.Popen(
        [*UDFLOW, "presets"], stdout=subprocess.PIPE, stderr=subprocess.PIPE
    ) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        process.stdout.close()
        assert process.stderr.read() == b""
    assert process.returncode == 0
