"""The command line as a user or a script meets it."""

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
from shapes import Sphere

import udflow
from udflow.cli import main
from udflow.cli.parser import MESH_FORMATS, PROTOCOLS
from udflow.cloud.formats import read_cloud
from udflow.config import Config, preset, to_dict
from udflow.mesh import export
from udflow.mesh.load import read_mesh
from udflow.metrics import protocols

RADIUS, CENTRE = 5.0, np.array([100.0, -20.0, 3.0])
QUICK = ["--resolution", "32", "--set", "densify.target_points=0", "--set", "spline.resolution=24"]
UDFLOW = [sys.executable, "-m", "udflow"]


def sphere_points(count: int, seed: int = 0) -> np.ndarray:
    return Sphere(0.5).sample(count, seed).numpy().astype(float) * (2 * RADIUS) + CENTRE


def off_sphere(points: np.ndarray) -> np.ndarray:
    return np.abs(np.linalg.norm(points - CENTRE, axis=1) - RADIUS)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a scan of a sphere and everything `reconstruct` makes of it."""
    folder = tmp_path_factory.mktemp("made")
    np.save(folder / "scan.npy", sphere_points(2_000))
    outputs = {"-o": "mesh.ply", "--field": "f.safetensors", "--report": "r.json"}
    outputs |= {"--points": "points.ply"}
    named = [part for flag, name in outputs.items() for part in (flag, str(folder / name))]
    assert main(["reconstruct", str(folder / "scan.npy"), *named, *QUICK, "--quiet"]) == 0
    return folder


@pytest.fixture
def scan(made: Path) -> str:
    return str(made / "scan.npy")


def run(*arguments: str, **options: object) -> subprocess.CompletedProcess[bytes]:
    return subprocess.run([*UDFLOW, *arguments], capture_output=True, check=False, **options)  # type: ignore[call-overload,no-any-return]


# --- help, versions, presets -------------------------------------------------------------------


def test_help_loads_nothing_heavy_and_states_the_exit_codes() -> None:
    code = (
        "import sys; from udflow.cli import main; main(['--help']);"
        "heavy = {'torch', 'scipy', 'numpy', 'rich', 'trimesh'} & set(sys.modules);"
        "sys.exit(f'loaded {heavy}' if heavy else 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, check=False, text=True)
    assert done.returncode == 0, done.stderr
    for line in ("exit codes:", "  130  interrupted", "reconstruct", "evaluate"):
        assert line in done.stdout


def test_version_is_that_of_the_package(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"udflow {udflow.__version__}\n"


def test_names_known_without_heavy_imports_are_the_real_ones() -> None:
    assert MESH_FORMATS == export.MESH_FORMATS
    assert PROTOCOLS == protocols.PROTOCOLS


def test_presets_in_json_are_what_a_request_may_say(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["presets", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["fast"] == to_dict(preset("fast"))


def test_presets_for_people_can_be_given_back_to_set(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["presets"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert f"  densify.threshold={Config().densify.threshold}" in lines
    assert "  spline.resolution=null" in lines


@pytest.mark.parametrize(
    "arguments",
    [[], ["reconstruct"], ["reconstruct", "a.ply"], ["melt", "a.ply"], ["inspect", "a", "--loud"]],
)
def test_a_wrong_command_line_is_usage(
    arguments: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(arguments) == 2
    assert "usage: udflow" in capsys.readouterr().err


# --- reconstruct -------------------------------------------------------------------------------


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


# --- inspect, densify --------------------------------------------------------------------------


def test_inspect_in_words_and_json(scan: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["inspect", scan, "--json"]) == 0
    summary = json.loads(capsys.readouterr().out)
    assert summary["unique_points"] == 2_000
    assert summary["extent"] == pytest.approx([2 * RADIUS] * 3, rel=0.01)
    assert main(["inspect", scan]) == 0
    assert "points   2000, 2000 distinct" in capsys.readouterr().out


def test_densify_adds_points_on_the_surface(
    scan: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "dense.ply"
    options = ["--target", "3000", "--set", "extract.resolution=32", "--quiet", "--json"]
    assert main(["densify", scan, "-o", str(out), *options]) == 0
    assert json.loads(capsys.readouterr().out)["points"]["densified"] == 3_000
    points = read_cloud(out).points
    assert len(points) == 3_000
    assert off_sphere(points).max() < 0.02 * RADIUS


# --- query -------------------------------------------------------------------------------------


def test_query_answers_in_the_units_of_the_scan(made: Path, tmp_path: Path) -> None:
    points = np.random.default_rng(1).uniform(-6, 6, (500, 3)) + CENTRE
    np.save(tmp_path / "q.npy", points)
    out = tmp_path / "d.npy"
    assert (
        main(["query", str(made / "f.safetensors"), str(tmp_path / "q.npy"), "-o", str(out)]) == 0
    )
    distance = np.load(out, allow_pickle=False)
    assert distance.dtype == np.float64
    np.testing.assert_allclose(distance, off_sphere(points), atol=0.02 * RADIUS)


def test_query_records_hold_gradient_foot_and_validity(made: Path, tmp_path: Path) -> None:
    points = np.array([[0, 0, RADIUS + 0.3], [RADIUS - 0.3, 0, 0], [900.0, 0, 0]]) + CENTRE
    np.savetxt(tmp_path / "q.xyz", points)
    out = tmp_path / "d.npy"
    field = str(made / "f.safetensors")
    wanted = ["--gradients", "--closest"]
    assert main(["query", field, str(tmp_path / "q.xyz"), "-o", str(out), *wanted]) == 0
    rows = np.load(out, allow_pickle=False)
    assert rows.dtype.names == ("distance", "gradient", "closest", "valid")
    np.testing.assert_allclose(rows["gradient"][:2], [[0, 0, 1], [-1, 0, 0]], atol=0.05)
    np.testing.assert_allclose(off_sphere(rows["closest"][:2]), 0, atol=0.02 * RADIUS)
    assert rows["valid"].tolist() == [True, True, False]


def test_query_streams(made: Path) -> None:
    points = io.BytesIO()
    np.save(points, sphere_points(10, seed=3))
    done = run("query", str(made / "f.safetensors"), "-", "-o", "-", input=points.getvalue())
    assert done.returncode == 0, done.stderr
    distance = np.load(io.BytesIO(done.stdout), allow_pickle=False)
    assert distance.max() < 0.02 * RADIUS
    assert b"10 distances" in done.stderr


def test_query_refuses_rows_it_cannot_answer(
    made: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    np.save(tmp_path / "q.npy", [[0.0, 0, 0], [np.nan, 0, 0]])
    out = tmp_path / "d.npy"
    assert (
        main(["query", str(made / "f.safetensors"), str(tmp_path / "q.npy"), "-o", str(out)]) == 3
    )
    assert "1 points have a coordinate that is not finite" in capsys.readouterr().err
    assert not out.exists()


@pytest.mark.parametrize("content", [None, b"", b"no field at all"])
def test_query_names_a_bad_field(
    content: bytes | None, scan: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    field = tmp_path / "bad.safetensors"
    if content is not None:
        field.write_bytes(content)
    assert main(["query", str(field), scan, "-o", str(tmp_path / "d.npy")]) == 3
    assert "bad.safetensors" in capsys.readouterr().err


# --- evaluate ----------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def truth(tmp_path_factory: pytest.TempPathFactory) -> str:
    path = tmp_path_factory.mktemp("truth") / "truth.obj"
    ball = trimesh.creation.icosphere(subdivisions=5, radius=RADIUS)
    ball.apply_translation(CENTRE)
    ball.export(path)
    return str(path)


def test_evaluate_measures_in_the_frame_of_the_reference(
    made: Path, truth: str, capsys: pytest.CaptureFixture[str]
) -> None:
    mesh, few = str(made / "mesh.ply"), ["--samples", "5000"]
    assert main(["evaluate", mesh, "--reference", truth, *few, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["extent"] == pytest.approx(2 * RADIUS, rel=1e-3)
    assert found["accuracy"]["mean"] < 5
    assert found["topology"]["euler_number"] == 2
    assert main(["evaluate", mesh, "--reference", truth, *few]) == 0
    shown = capsys.readouterr().out
    assert f"{found['accuracy']['mean']:.4f}" in shown
    assert "watertight" in shown


def test_evaluate_by_protocol(
    made: Path, truth: str, scan: str, capsys: pytest.CaptureFixture[str]
) -> None:
    base = ["evaluate", str(made / "mesh.ply"), "--samples", "3000", "--json", "--reference"]
    assert main([*base, truth, "--protocol", "capudf-cars"]) == 0
    assert "chamfer-L2 x 1e4" in json.loads(capsys.readouterr().out)["figures"]
    assert main([*base, scan, "--protocol", "capudf-srb"]) == 0
    assert json.loads(capsys.readouterr().out)["figures"]["chamfer-L1 x 10"] < 1
    assert main([*base, truth, "--protocol", "capudf-3dscene"]) == 2
    assert "add --scan" in capsys.readouterr().err


def test_evaluate_wants_triangles(
    made: Path, scan: str, truth: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["evaluate", scan, "--reference", truth]) == 3
    assert "triangles" in capsys.readouterr().err
    assert main(["evaluate", truth, "--reference", truth, "--seeds", "1"]) == 2
    assert "at least 3" in capsys.readouterr().err
