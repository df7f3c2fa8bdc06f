"""A job that makes another mesh from the field of an earlier one."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict
from pathlib import Path

from jobs.soundness import Soundness
from jobs.spec import JobRecord
from jobs.store import FileStore
from udflow.cloud.formats import read_cloud
from udflow.config import from_dict
from udflow.errors import BadField, UdflowError
from udflow.fields.storage import load_field
from udflow.progress import Progress
from udflow.reextract import reextract
from worker.outputs import Output, meshes_of, report_of


class SourceGone(UdflowError):
    """The job whose field is needed has been deleted, or has no field."""

    code = "source_gone"


def extract_again(
    job: JobRecord,
    source: JobRecord | None,
    store: FileStore,
    step: Callable[[Progress], None],
) -> Iterator[Output]:
    """Meshes and report of an extraction.

    source: the job whose field is used.

    Raises:
        SourceGone: its files are not there any more.
        EmptySurface: there is no surface in the box.
    """
    field_path = _file(source, "field.safetensors", store)
    cloud = read_cloud(_file(source, "points.ply", store))
    device = job.device or "cpu"
    began = time.monotonic()
    count = len(cloud.points)
    step(Progress("extracting", 0, 1, 0.05, 0.0, count))
    config = from_dict(job.config).extract
    measured = _measured(source, store)
    mesh = reextract(load_field(field_path, device), cloud, config, job.box, device, measured)
    seconds = time.monotonic() - began
    step(Progress("exporting", 0, 1, 1.0, seconds, count))
    yield from meshes_of(mesh)
    yield report_of(
        {
            "source": job.source,
            "extract": asdict(config),
            "box": job.box,
            "device": device,
            "points": count,
            "mesh": {"vertices": len(mesh.vertices), "faces": len(mesh.faces)},
            "seconds": {"extracting": seconds},
        }
    )


def _measured(source: JobRecord | None, store: FileStore) -> int | None:
    """How many of the points were measured; None from a job that was to leave no report."""
    if source is None or "report.json" not in source.outputs:
        return None
    points = json.loads(_file(source, "report.json", store).read_text())["points"]
    return int(points.get("measured", points["unique"]))


def _file(source: JobRecord | None, name: str, store: FileStore) -> Path:
    artifact = source.outputs.get(name) if source is not None else None
    path = store.artifact_path(artifact) if artifact is not None else None
    if path is None or not path.is_file():
        raise SourceGone(f"{name} of the job to extract from is gone; reconstruct the scan again")
    if artifact is not None and not Soundness().is_sound(path, artifact):
        raise BadField(f"{name} of the job to extract from is damaged; reconstruct the scan again")
    return path
