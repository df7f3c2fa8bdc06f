"""What a caller may see of a reconstruction between two steps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from udflow.cloud.normalisation import Normalisation
from udflow.config import ExtractConfig
from udflow.errors import EmptySurface
from udflow.fields.interface import ProjectiveField
from udflow.mesh.extract import extract
from udflow.progress import CoarseMesh, GrownCloud


@dataclass(frozen=True)
class Glance:
    """A `udflow.progress.Look`; nothing is computed before it is asked for.

    Attributes:
        fits: finished fits so far.
        samples: the densified cloud, (n, 3), unit frame.
        births: points that came in each round, the measured ones first.
        normalisation: between world and unit frame.
        field: of the last finished fit, unit frame; None before there is one.
    """

    fits: int
    samples: Tensor
    births: tuple[int, ...]
    normalisation: Normalisation
    field: ProjectiveField | None

    def cloud(self) -> GrownCloud:
        """The densified cloud so far."""
        points = self.normalisation.to_world(self.samples.cpu().numpy())
        return GrownCloud(points, np.repeat(np.arange(len(self.births)), self.births))

    def mesh(self, resolution: int) -> CoarseMesh | None:
        """The surface of the last finished fit; None before there is one, or if it is empty."""
        if self.field is None:
            return None
        try:
            with torch.inference_mode():
                mesh = extract(self.field, self.samples, ExtractConfig(resolution))
        except EmptySurface:
            return None
        return CoarseMesh(self.normalisation.to_world(mesh.vertices), mesh.faces)
