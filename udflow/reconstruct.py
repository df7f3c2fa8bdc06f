"""The whole story: cloud -> field -> mesh. Read this first."""

from __future__ import annotations

import time
from collections.abc import Callable, Generator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch

import udflow
from udflow import densify
from udflow.cloud.inspection import require_reconstructable
from udflow.cloud.normalisation import Normalisation
from udflow.cloud.point_cloud import PointCloud
from udflow.cloud.sampled_surface import SampledSurface
from udflow.config import Config, ExtractConfig, to_dict
from udflow.errors import EmptySurface
from udflow.fields.unsigned import SurfaceField, UnsignedDistanceField
from udflow.fit.spline import SplineFit, finest_resolution, fit_spline
from udflow.mesh.colour import transfer_colors
from udflow.mesh.extract import extract
from udflow.mesh.mesh import Mesh
from udflow.mesh.settling import settled
from udflow.progress import CoarseMesh, GrownCloud, Progress, Stage

_SITE_PER_VOXEL = 0.5  # detail of the data that a mesh of a given voxel can show


@dataclass(frozen=True)
class Reconstruction:
    """What a reconstruction gives back, all in the units and frame of the upload.

    Attributes:
        mesh: the surface, with colours where the cloud has them.
        field: answers distance queries.
        points: the densified cloud.
        report: parameters, versions, timings, counts; JSON values only.
    """

    mesh: Mesh
    field: UnsignedDistanceField
    points: PointCloud
    report: dict[str, Any]


def reconstruct(
    cloud: PointCloud,
    config: Config | None = None,
    *,
    device: str = "cpu",
    on_progress: Callable[[Progress], None] | None = None,
) -> Reconstruction:
    """Reconstructs a surface and its unsigned distance field from a point cloud.

    Args:
        cloud: points in any units and frame.
        config: parameters; the preset "fast" if None.
        device: a torch device, such as "cpu" or "cuda".
        on_progress: called with every `Progress`.

    Raises:
        InvalidCloud: nothing can be made of these points; the message says why.
        Diverged, EmptySurface: the fit or the extraction failed; the message says what to change.
    """
    steps = reconstruct_steps(cloud, config or Config(), device)
    while True:
        try:
            progress = next(steps)
        except StopIteration as done:
            result: Reconstruction = done.value
            return result
        if on_progress is not None:
            on_progress(progress)


def reconstruct_steps(
    cloud: PointCloud,
    config: Config,
    device: str = "cpu",
    enough: Callable[[], bool] = lambda: False,
) -> Generator[Progress, None, Reconstruction]:
    """`reconstruct` as a generator: yields progress, returns the `Reconstruction`.

    Between two yields a caller may stop, publish or save; nothing is lost by waiting. Once
    `enough` says so no more is fitted, and the mesh is made of the last whole fit; the first fit
    is always finished.
    """
    require_reconstructable(cloud)
    with torch.inference_mode():
        return (yield from _Run(cloud, config, device, enough).steps())


class _Run:
    """One reconstruction under way: what the stages hand to each other, and the clock."""

    def __init__(
        self, cloud: PointCloud, config: Config, device: str, enough: Callable[[], bool]
    ) -> None:
        self.cloud = cloud
        self.config = config
        self.enough = enough
        self.partial = False
        self.normalisation = Normalisation.of(cloud.points)
        unit = np.unique(self.normalisation.to_unit(cloud.points), axis=0)
        self.measured = torch.from_numpy(unit).to(device)
        self._quadrics: SampledSurface | None = None
        self.samples = self.measured
        self.generator = torch.Generator().manual_seed(config.seed)
        self.rounds = densify.rounds_needed(len(unit), config.densify)
        self.round = 0
        self.births = [len(unit)]  # points that came in each round, the measured ones first
        self.latest: SplineFit | None = None
        self.fits = 0
        self.loss: float | None = None
        self.started = time.monotonic()
        self.seconds: dict[str, float] = {}

    def steps(self) -> Generator[Progress, None, Reconstruction]:
        yield self._progress("reading", 1, 1)
        fit = yield from self._fitted("fitting")
        while self.round < self.rounds and not self.partial:
            grown = densify.reflow(
                self.samples, self.measured, fit.field, self.config.densify, self.generator
            )
            if len(grown) == len(self.samples):
                break
            self.births.append(len(grown) - len(self.samples))
            self.samples = grown
            self.round += 1
            fit = yield from self._fitted("densifying", fit)
        yield self._progress("extracting", 0, 1)
        mesh = self._extracted(fit)
        self._clock("extracting")
        yield self._progress("exporting", 0, 1)
        result = self._finished(fit, mesh)
        yield self._progress("exporting", 1, 1)
        return result

    def _fitted(
        self, stage: Stage, earlier: SplineFit | None = None
    ) -> Generator[Progress, None, SplineFit]:
        """A new fit, or the earlier one when it is to be enough."""
        yield self._progress(stage, 0, self.config.flow.steps)
        surface = self._surface()
        fitting = fit_spline(surface, self.config)
        while True:
            try:
                solved = next(fitting)
            except StopIteration as done:
                fit: SplineFit = done.value
                break
            yield self._progress(stage, solved, self.config.flow.steps)
            self.partial = self.enough()
            if self.partial and earlier is not None:
                self._clock(stage)
                return earlier
        self.loss = fit.loss
        self.latest, self.fits = fit, self.fits + 1
        self._clock(stage)
        return fit

    def _extracted(self, fit: SplineFit) -> Mesh:
        field = SurfaceField(fit.field, self._measured_surface().surface)
        mesh = extract(field, self.samples, self.config.extract)
        voxel = 1.0 / self.config.extract.resolution
        return settled(mesh, field, voxel, self.samples.device)

    def _surface(self) -> SampledSurface:
        """What the trajectories are drawn to: the measured points and, with quadrics fitted to
        the same, the points of the rounds so far."""
        measured = self._measured_surface()
        added = self.samples[len(self.measured) :]
        return measured.densified(added) if len(added) else measured

    def _measured_surface(self) -> SampledSurface:
        if self._quadrics is None:
            detail = _SITE_PER_VOXEL / self.config.extract.resolution
            self._quadrics = SampledSurface.of(self.measured, detail)
        return self._quadrics

    def _finished(self, fit: SplineFit, mesh: Mesh) -> Reconstruction:
        vertices = self.normalisation.to_world(mesh.vertices)
        colors = transfer_colors(vertices, self.cloud)
        points = self.normalisation.to_world(self.samples.cpu().numpy())
        self._clock("exporting")
        return Reconstruction(
            mesh=replace(mesh, vertices=vertices, colors=colors),
            field=UnsignedDistanceField(
                fit.field, self._measured_surface().surface, self.normalisation
            ),
            points=PointCloud(points, colors=transfer_colors(points, self.cloud)),
            report=self._report(mesh),
        )

    def _report(self, mesh: Mesh) -> dict[str, Any]:
        scale = self.normalisation.scale
        surface = self._measured_surface()
        return {
            "version": udflow.__version__,
            "torch": torch.__version__,
            "device": str(self.samples.device),
            "config": to_dict(self.config),
            "points": {
                "input": len(self.cloud.points),
                "unique": len(self.measured),
                "densified": len(self.samples),
                "rounds": self.round,
            },
            "partial": self.partial,
            "frame": {"centre": list(self.normalisation.centre), "scale": scale},
            "spacing": surface.spacing * scale,
            "sample_error": surface.error * scale,
            "spline_resolution": finest_resolution(surface.spacing, self.config),
            "loss": self.loss,
            "mesh": {"vertices": len(mesh.vertices), "faces": len(mesh.faces)},
            "seconds": {**self.seconds, "total": time.monotonic() - self.started},
            "warnings": list(self.cloud.warnings),
        }

    def _clock(self, stage: Stage) -> None:
        """Books the time since the last booking to a stage."""
        spent = sum(self.seconds.values())
        now = time.monotonic() - self.started
        self.seconds[stage] = self.seconds.get(stage, 0.0) + now - spent

    def _progress(self, stage: Stage, step: int, total: int) -> Progress:
        return Progress(
            stage=stage,
            step=step,
            total=total,
            fraction=self._fraction(stage, step / total),
            elapsed_s=time.monotonic() - self.started,
            points=len(self.samples),
            round=self.round,
            rounds=self.rounds,
            loss=self.loss,
            look=_Glance(self),
        )

    def _fraction(self, stage: Stage, within: float) -> float:
        """Position in the whole: a fit counts as one part, the extraction as another."""
        parts = self.rounds + 2.0
        done = {
            "reading": 0.0,
            "fitting": within,
            "densifying": self.round + within,
            "extracting": self.rounds + 1 + 0.9 * within,
            "exporting": self.rounds + 1.9 + 0.1 * within,
        }
        return min(done[stage] / parts, 1.0)


class _Glance:
    """What a caller may see of a run between two steps: a `Look`."""

    def __init__(self, run: _Run) -> None:
        self._run = run

    @property
    def fits(self) -> int:
        return self._run.fits

    def cloud(self) -> GrownCloud:
        points = self._run.normalisation.to_world(self._run.samples.cpu().numpy())
        births = self._run.births
        return GrownCloud(points, np.repeat(np.arange(len(births)), births))

    def mesh(self, resolution: int) -> CoarseMesh | None:
        run = self._run
        if run.latest is None:
            return None
        field = SurfaceField(run.latest.field, run._measured_surface().surface)
        try:
            with torch.inference_mode():
                mesh = extract(field, run.samples, ExtractConfig(resolution))
        except EmptySurface:
            return None
        return CoarseMesh(run.normalisation.to_world(mesh.vertices), mesh.faces)
