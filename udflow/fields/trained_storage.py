"""Trained fields as tensors and a header, and back: the part of `storage` that knows networks."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import torch
from torch import Tensor

from udflow.errors import BadField, InvalidConfig
from udflow.fields.cap_udf import CapUdfField
from udflow.fields.mlp import MLPField
from udflow.fields.network import Network
from udflow.flow.schedule import TimeSchedule
from udflow.neural_config import NetworkConfig

TRAINED_FORMAT = "udflow-trained-field"
_MAX_EDGE = 1e3  # half edges and reaches are a few extents at most


def trained_parts(field: MLPField | CapUdfField) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """Tensors and header of a trained field."""
    header = {
        "format": TRAINED_FORMAT,
        "network": dataclasses.asdict(field.config),
        "steps": field.schedule.steps if isinstance(field, MLPField) else 0,
        "reach": field.reach,
        "half_edge": field.half_edge,
    }
    return {"parameters": field.parameters.cpu().contiguous()}, header


def trained_field(header: dict[str, Any], parameters: Tensor) -> MLPField | CapUdfField:
    """The field of a header and its parameters; 0 steps is a field without time.

    Raises:
        BadField: an impossible network, or parameters that are not its own or not finite.
    """
    described = header["network"]
    if not isinstance(described, dict):
        raise BadField("the field describes an impossible network: it has no parts")
    values: dict[str, Any] = {}
    for key, value in described.items():
        values[key] = tuple(value) if isinstance(value, list) else value
    try:
        config = NetworkConfig(**values)
    except (InvalidConfig, TypeError) as error:
        raise BadField(f"the field describes an impossible network: {error}") from error
    if parameters.dtype != torch.float32 or parameters.shape != (Network(config).size,):
        raise BadField("the field has the wrong number of parameters for its network")
    if not bool(torch.isfinite(parameters).all()):
        raise BadField("the field has parameters that are not finite")
    reach, half_edge = float(header["reach"]), float(header["half_edge"])
    if not all(math.isfinite(x) and 0 < x < _MAX_EDGE for x in (reach, half_edge)):
        raise BadField("the field claims an impossible box")
    steps = int(header["steps"])
    if steps == 0:
        return CapUdfField(config, parameters, reach, half_edge)
    return MLPField(config, TimeSchedule(steps), parameters, reach, half_edge)
