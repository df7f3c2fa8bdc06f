"""The part of a report that follows from what was asked for."""

from __future__ import annotations

from typing import Any

import torch

import udflow
from udflow.cloud.normalisation import Normalisation
from udflow.cloud.sampled_surface import SampledSurface
from udflow.config import Config, to_dict
from udflow.fields.network import Network
from udflow.fit.neural import network_config
from udflow.fit.spline import finest_resolution


def about_run(config: Config, frame: Normalisation, surface: SampledSurface) -> dict[str, Any]:
    """Versions, parameters and what is known of the cloud; JSON values only, lengths in the units
    of the cloud."""
    return {
        "version": udflow.__version__,
        "torch": torch.__version__,
        "config": to_dict(config),
        "frame": {"centre": list(frame.centre), "scale": frame.scale},
        "spacing": surface.spacing * frame.scale,
        "sample_error": surface.error * frame.scale,
        **_about_field(config, surface.spacing),
    }


def _about_field(config: Config, spacing: float) -> dict[str, Any]:
    if config.field == "spline":
        return {"spline_resolution": finest_resolution(spacing, config)}
    network = Network(network_config(config))
    return {
        "parameters": network.size,
        "flops_per_iteration": network.flops(config.training.batch),
    }
