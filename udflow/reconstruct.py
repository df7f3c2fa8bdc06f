"""The whole story: cloud -> field -> mesh. Read this first."""

from __future__ import annotations

import time
from collections.abc import Callable, Generator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from udflow import densify
from udflow.cloud.inspection import require_reconstructable
from udflow.cloud.normalisation import Normalisation
from udflow.cloud.outliers import without_scattered
from udflow.cloud.point_cloud import PointCloud
from udflow.cloud.sampled_surface import SampledSurface
from udflow.config import Config
from udflow.fields.interface import ProjectiveField
from udflow.fields.unsigned import SurfaceField, UnsignedDistanceField
from udflow.fit.checkpoint import Keeper, origin_of
from udflow.fit.kinds import Fit, fitting_of
from udflow.fit.spline import SplineFit
from udflow.glance import Glance
from udflow.mesh.colour import transfer_colors
from udflow.mesh.extract import extract
from udflow.mesh.mesh import Mesh
from udflow.progress import Progress, Stage
from udflow.report import about_run

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
    checkpoint: Path | None = None,
) -> Reconstruction:
    """Reconstructs a surface and its unsigned distance field from a point cloud.

    Args:
        cloud: points in any units and frame.
        config: parameters; the preset "fast" if None.
        device: a torch device, such as "cpu" or "cuda".
        on_progress: called with every `Progress`.
        checkpoint: file that the reconstruction is saved to now and then, and gone on with where
            it exists already; see `reconstruct_steps`. Removed in the end.

    Raises:
        BadCheckpoint: the file is damaged, or of another cloud or configuration.
        InvalidCloud: nothing can be made of these points; the message says why.
        Diverged, EmptySurface: the fit or the extraction failed; the message says what to change.
    """
    steps = reconstruct_steps(cloud, config or Config(), device, checkpoint=checkpoint)
    while True:
        try:
            progress = next(steps)
        except StopIteration as done:
            result: Reconstruction = done.value
            if checkpoint is not None:
                checkpoint.unlink(missing_ok=True)
            return result
        if on_progress is not None:
            on_progress(progress)


def reconstruct_steps(
    cloud: PointCloud,
    config: Config,
    device: str = "cpu",
    enough: Callable[[], bool] = lambda: False,
    *,
    checkpoint: Path | None = None,
    checkpoint_s: float = 30.0,
    checkpoint_now: Callable[[], bool] = lambda: False,
) -> Generator[Progress, None, Reconstruction]:
    """`reconstruct` as a generator: yields progress, returns the `Reconstruction`.

    Between two yields a caller may stop, publish or save; nothing is lost by waiting. Once
    `enough` says so no more is fitted, and the mesh is made of the last whole fit; a first fit
    that is trained is used as it is then, one that is solved is finished.

    What there is goes to `checkpoint` after every round of densification and after every fit; a
    trained field also while it is fitted, every `checkpoint_s` seconds and when `checkpoint_now`
    says so. Where the file exists already the reconstruction goes on from there, on the same
    machine bit for bit as if it had never stopped. The file stays: whoever has the result may
    remove it. A disk that is full costs the checkpoint, not the reconstruction.
    """
    require_reconstructable(cloud)
    with torch.inference_mode():
        run = _Run(cloud, config, device, enough)
        if checkpoint is not None:
            run.keep(checkpoint, checkpoint_s, checkpoint_now)
        return (yield from run.steps())


def _measured(
    points: NDArray[np.float64], config: Config
) -> tuple[Normalisation, NDArray[np.float32], int]:
    """The frame of (n, 3) world points, the distinct ones of them in it that are reconstructed,
    and how many distinct ones there are."""
    frame = Normalisation.of(points)
    unit = np.unique(frame.to_unit(points), axis=0)
    kept = np.arange(len(unit))
    if config.outliers == "drop":
        kept = without_scattered(torch.from_numpy(unit)).numpy()
    if len(kept) == len(unit):
        return frame, unit, len(unit)
    # what was left out may have been far away: the rest gets a frame of its own
    _, row = np.unique(frame.to_unit(points), axis=0, return_index=True)
    frame = Normalisation.of(points[row[kept]])
    return frame, np.unique(frame.to_unit(points[row[kept]]), axis=0), len(unit)


class _Run:
    """One reconstruction under way: what the stages hand to each other, and the clock."""

    def __init__(
        self, cloud: PointCloud, config: Config, device: str, enough: Callable[[], bool]
    ) -> None:
        self.cloud = cloud
        self.config = config
        self.enough = enough
        self.partial = False
        self.normalisation, unit, self.distinct = _measured(cloud.points, config)
        self.measured = torch.from_numpy(unit).to(device)
        self._quadrics: SampledSurface | None = None
        self.samples = self.measured
        self.generator = torch.Generator().manual_seed(config.seed)
        self.rounds = densify.rounds_needed(len(unit), config.densify)
        self.round = 0
        self.births = [len(unit)]  # points that came in each round, the measured ones first
        self.counts: list[dict[str, int]] = []  # counters of each round
        self.keeper: Keeper | None = None
        self.latest: Fit | None = None
        self.fits = 0
        self.loss: float | None = None
        self.started = time.monotonic()
        self.seconds: dict[str, float] = {}

    def steps(self) -> Generator[Progress, None, Reconstruction]:
        yield self._progress("reading", 1, 1)
        fit = yield from self._fitted("densifying" if self.round else "fitting")
        while self.round < self.rounds and not self.partial and self._grown(fit):
            fit = yield from self._fitted("densifying", fit)
        yield self._progress("extracting", 0, 1)
        mesh = self._extracted(fit)
        self._clock("extracting")
        yield self._progress("exporting", 0, 1)
        result = self._finished(fit, mesh)
        yield self._progress("exporting", 1, 1)
        return result

    def keep(self, path: Path, every_s: float, now: Callable[[], bool]) -> None:
        """Saves to `path` from now on, and goes on from what is there."""
        self.keeper = Keeper(path, every_s, now, origin_of(self.measured, self.config))
        stored = self.keeper.stored
        if stored is not None:
            self.samples = stored.samples.to(self.measured.device)
            self.generator.set_state(stored.generator)
            self.counts = list(stored.rounds)
            self.births += [counts["added"] for counts in stored.rounds]
            self.round = len(stored.rounds)

    def _grown(self, fit: Fit) -> bool:
        """One round of densification; whether it added anything."""
        before, how = densify.Round(self.round, self.samples, 0), self.config.densify
        after = densify.reflow_round(before, self.measured, fit.field, how, self.generator)
        if after.added == 0:
            return False
        self.samples, self.round = after.samples, after.number
        self.births.append(after.added)
        self.counts.append(after.counts())
        return True

    def _fitted(self, stage: Stage, earlier: Fit | None = None) -> Generator[Progress, None, Fit]:
        """A new fit, or the stored one, or the earlier one when it is to be enough."""
        stored = self.keeper.take_solved() if self.keeper is not None else None
        fit = stored or (yield from self._newly_fitted(stage, earlier))
        if fit is not earlier:
            self.loss, self.latest, self.fits = fit.loss, fit, self.fits + 1
        self._clock(stage)
        return fit

    def _newly_fitted(self, stage: Stage, earlier: Fit | None) -> Generator[Progress, None, Fit]:
        place = (tuple(self.counts), self.samples, self.generator.get_state())
        keeper = self.keeper
        if isinstance(earlier, SplineFit):
            # it knows the quadrics, and the points that a round has added lie on these
            if keeper is not None:
                keeper.whole(None, earlier, *place)
            yield self._progress(stage, 1, 1)
            self.partial = self.enough()
            return earlier
        surface, numbers = self._surface(), (self.round, self.rounds)
        fitting = fitting_of(self.samples, surface, self.config, *numbers, earlier, self.generator)
        if keeper is not None and not keeper.resume(fitting) and self.round:
            keeper.begun(fitting, *place)
        yield self._progress(stage, 0, fitting.total)
        steps = fitting.run()
        while True:
            try:
                done = next(steps)
            except StopIteration as whole:
                fit: Fit = whole.value
                if keeper is not None:
                    keeper.whole(fitting, fit, *place)
                return fit
            if keeper is not None:
                keeper.offer(fitting, *place)
            yield self._progress(stage, done, fitting.total)
            self.partial = self.enough()
            early = (earlier or fitting.early()) if self.partial else None
            if early is not None:
                return early

    def _extracted(self, fit: Fit) -> Mesh:
        field = self.unit_field(fit)
        # Added points lie where the quadrics put them: where there is data, only data can say.
        known = self.samples if self._stands_alone() else self.measured
        return extract(field, known, self.config.extract)

    def unit_field(self, fit: Fit) -> ProjectiveField:
        """What is extracted."""
        if self._stands_alone():
            return fit.field
        return SurfaceField(fit.field, self._surface().surface)

    def _stands_alone(self) -> bool:
        """Whether the field is trained to the samples alone, as the paper's, without quadrics."""
        return self.config.field != "spline" and self.config.training.targets == "points"

    def _surface(self) -> SampledSurface:
        """What the trajectories are drawn to."""
        if self._quadrics is None:
            detail = _SITE_PER_VOXEL / self.config.extract.resolution
            self._quadrics = SampledSurface.of(self.measured, detail)
        return self._quadrics

    def _finished(self, fit: Fit, mesh: Mesh) -> Reconstruction:
        vertices = self.normalisation.to_world(mesh.vertices)
        colors = transfer_colors(vertices, self.cloud)
        points = self.normalisation.to_world(self.samples.cpu().numpy())
        self._clock("exporting")
        return Reconstruction(
            mesh=replace(mesh, vertices=vertices, colors=colors),
            field=UnsignedDistanceField(fit.field, self._surface().surface, self.normalisation),
            points=PointCloud(points, colors=transfer_colors(points, self.cloud)),
            report=self._report(mesh),
        )

    def _report(self, mesh: Mesh) -> dict[str, Any]:
        surface = self._surface()
        return {
            **about_run(self.config, self.normalisation, surface),
            "warnings": [*self.cloud.warnings, *self._left_out()],
            "device": str(self.samples.device),
            "points": {
                "input": len(self.cloud.points),
                "unique": self.distinct,
                "measured": len(self.measured),
                "densified": len(self.samples),
                "rounds": self.round,
            },
            "densification": self.counts,
            "partial": self.partial,
            "loss": self.loss,
            "mesh": {"vertices": len(mesh.vertices), "faces": len(mesh.faces)},
            "seconds": {**self.seconds, "total": time.monotonic() - self.started},
        }

    def _left_out(self) -> list[str]:
        """What is said of points that were left out."""
        count = self.distinct - len(self.measured)
        if count == 0:
            return []
        return [f"left out {count} points that are scattered in space, on no surface"]

    def _glance(self) -> Glance:
        field = None if self.latest is None else self.unit_field(self.latest)
        births = tuple(self.births)
        return Glance(self.fits, self.samples, births, self.normalisation, field)

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
            look=self._glance(),
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
