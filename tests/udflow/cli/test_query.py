"""`udflow query`: distances of a stored field."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pytest
from command_line import CENTRE, RADIUS, off_sphere, run, sphere_points

from udflow.cli import main


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
