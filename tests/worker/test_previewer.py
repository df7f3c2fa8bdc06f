"""Preview frames: what is in them, how often they come, and that looking changes nothing."""

from __future__ import annotations

import struct
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pytest
import redis
from shapes import Sphere

from jobs.events import Events
from jobs.keys import watched
from jobs.previews import KINDS, MAX_BYTES, Previews, sequence_of
from jobs.records import JobRecords
from jobs.spec import JobRecord, JobSpec
from udflow.cloud.point_cloud import PointCloud
from udflow.config import Config, DensifyConfig, ExtractConfig, FlowConfig, preset, to_dict
from udflow.mesh.mesh import Mesh
from udflow.progress import CoarseMesh, GrownCloud, Progress
from udflow.reconstruct import reconstruct_steps
from worker import previewer
from worker.frames import MAX_POINTS, mesh_frame, points_frame
from worker.previewer import Previewer

SMALL = Config(
    flow=FlowConfig(steps=2),
    densify=DensifyConfig(target_points=900, points_per_round=200),
    extract=ExtractConfig(resolution=24),
)


@dataclass(frozen=True)
class Frame:
    """A frame as its layout says, read without the code that wrote it."""

    kind: int
    sequence: int
    total: int
    round: int
    rounds: int
    positions: Any
    faces: Any = field(repr=False)
    born: Any = field(repr=False)


def padded(size: int) -> int:
    return -(-size // 4) * 4


def read(frame: bytes) -> Frame:
    assert frame[:5] == b"UDFP\x01"
    kind, flags = frame[5], struct.unpack_from("<H", frame, 6)[0]
    sequence, count, triangles, total = struct.unpack_from("<4I", frame, 8)
    round_, rounds = struct.unpack_from("<2H", frame, 24)
    origin, scale = np.frombuffer(frame, "<f8", 3, 32), struct.unpack_from("<d", frame, 56)[0]
    codes = np.frombuffer(frame, "<u2", 3 * count, 64).reshape(-1, 3)
    end = 64 + padded(6 * count)
    faces = np.frombuffer(frame, "<u4", 3 * triangles, end).reshape(-1, 3)
    end += 12 * triangles
    born = np.frombuffer(frame, np.uint8, count if flags & 1 else 0, end)
    assert len(frame) == end + padded(len(born))
    return Frame(
        kind, sequence, total, round_, rounds, origin + scale * codes / 65535.0, faces, born
    )


@pytest.mark.parametrize("away", [0.0, 5e6])
def test_points_come_back_within_half_a_code(away: float) -> None:
    points = np.random.default_rng(0).uniform(-1, 1, (1001, 3)) * [3.0, 1.0, 0.1] + away
    rounds = np.repeat([0, 1, 2], [501, 300, 200])
    frame = read(points_frame(GrownCloud(points, rounds), 7, 13))
    assert (frame.kind, frame.sequence, frame.total) == (1, 7, 1001)
    assert (frame.round, frame.rounds) == (2, 13)
    assert np.abs(frame.positions - points).max() <= 6.0 / 65535 / 2 * 1.01 + 1e-9
    assert np.array_equal(frame.born, rounds)


def test_large_clouds_are_thinned_to_the_limit() -> None:
    points = np.random.default_rng(0).normal(size=(3 * MAX_POINTS, 3))
    encoded = points_frame(GrownCloud(points, np.full(len(points), 3)), 1, 3)
    frame = read(encoded)
    assert len(encoded) <= MAX_BYTES
    assert len(frame.positions) == MAX_POINTS
    assert frame.total == 3 * MAX_POINTS


def test_a_single_point_is_a_frame_too() -> None:
    frame = read(points_frame(GrownCloud(np.array([[4.0, 5.0, 6.0]]), np.zeros(1, int)), 1, 0))
    assert np.array_equal(frame.positions, [[4.0, 5.0, 6.0]])


def test_a_mesh_keeps_its_triangles() -> None:
    vertices = np.array([[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 0.5]])
    faces = np.array([[0, 1, 2], [1, 2, 3], [3, 0, 1]])
    encoded = mesh_frame(CoarseMesh(vertices, faces), 9, 2, 5)
    assert encoded is not None
    frame = read(encoded)
    assert (frame.kind, frame.sequence, frame.round, frame.rounds) == (2, 9, 2, 5)
    assert np.array_equal(frame.faces, faces)
    assert np.allclose(frame.positions, vertices, atol=2e-5)


def test_a_mesh_that_is_too_large_is_left_out() -> None:
    vertices = np.zeros((70_000, 3))
    assert mesh_frame(CoarseMesh(vertices, np.zeros((1, 3), int)), 1, 0, 0) is None


@pytest.fixture
def job(records: JobRecords) -> JobRecord:
    spec = JobSpec.new("scan_" + "0" * 32, to_dict(preset("fast")))
    records.create(spec)
    claimed = records.claim(spec.id, 1)
    assert claimed is not None
    return claimed


@pytest.fixture
def pictures(connection: redis.Redis) -> Previews:
    return Previews(connection)


def run(config: Config, show: Any = None) -> Mesh:
    """A small reconstruction that is shown while it runs."""
    steps = reconstruct_steps(PointCloud(Sphere().sample(400).double().numpy()), config)
    while True:
        try:
            progress = next(steps)
        except StopIteration as end:
            mesh: Mesh = end.value.mesh
            return mesh
        if show is not None:
            show(progress)


def notices(events: Events, job: JobRecord) -> list[dict[str, Any]]:
    return [event.data for event in events.read(job.id) if event.type == "preview"]


def test_each_round_and_the_fit_are_shown_to_those_who_watch(
    records: JobRecords,
    pictures: Previews,
    events: Events,
    job: JobRecord,
    settings: Any,
    connection: redis.Redis,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(previewer, "PERIOD_S", 0.0)
    monkeypatch.setattr(previewer, "_REST", 0.0)
    connection.set(watched(job.id), "1")
    shown: dict[str, list[Frame]] = {kind: [] for kind in KINDS}
    with settings.connect_raw() as raw:

        def show(progress: Progress) -> None:
            before = len(notices(events, job))
            drawer.show(progress)
            for notice in notices(events, job)[before:]:
                frame = raw.get(f"udflow:job:{job.id}:preview:{notice['kind']}")
                assert notice["bytes"] == len(frame)
                assert notice["sequence"] == sequence_of(frame)
                shown[notice["kind"]].append(read(frame))

        drawer = Previewer(records, pictures, job)
        run(SMALL, show)
    assert [frame.total for frame in shown["points"]] == [400, 600, 800, 900]
    assert [frame.round for frame in shown["points"]] == [0, 1, 2, 3]
    assert len(shown["mesh"]) == 1  # of the one fit
    for frame in (*shown["points"], *shown["mesh"]):
        assert np.abs(np.linalg.norm(frame.positions, axis=1) - 0.5).max() < 0.05
    sequences = [notice["sequence"] for notice in notices(events, job)]
    assert sequences == sorted(set(sequences))


def test_meshes_are_not_made_for_nobody(
    records: JobRecords,
    pictures: Previews,
    events: Events,
    job: JobRecord,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(previewer, "PERIOD_S", 0.0)
    run(SMALL, Previewer(records, pictures, job).show)
    assert {notice["kind"] for notice in notices(events, job)} == {"points"}


def test_at_most_one_frame_a_second(
    records: JobRecords, pictures: Previews, events: Events, job: JobRecord
) -> None:
    drawer = Previewer(records, pictures, job)
    look = next(reconstruct_steps(PointCloud(Sphere().sample(400).double().numpy()), SMALL)).look
    base = Progress("densifying", 0, 1, 0.5, 0.0, 400, look=look)
    for points in range(400, 450):
        drawer.show(replace(base, points=points))
    assert len(notices(events, job)) == 1


def test_a_lost_attempt_announces_nothing(
    records: JobRecords, pictures: Previews, events: Events, job: JobRecord
) -> None:
    records.requeue(job.id, job.attempt, crashed=True, why="a test")
    run(
        replace(SMALL, densify=DensifyConfig(target_points=0)),
        Previewer(records, pictures, job).show,
    )
    assert notices(events, job) == []


def test_looking_changes_nothing() -> None:
    def look(progress: Progress) -> None:
        assert progress.look is not None
        progress.look.cloud()
        progress.look.mesh(16)

    watched_mesh, unwatched = run(SMALL, look), run(SMALL)
    assert np.array_equal(watched_mesh.vertices, unwatched.vertices)
    assert np.array_equal(watched_mesh.faces, unwatched.faces)
