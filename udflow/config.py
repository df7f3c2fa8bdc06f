"""All parameters of a reconstruction: small frozen objects that check themselves.

Lengths are in units of the normalised cloud (largest extent 1) unless said otherwise.
This module imports no torch, so that a client or a request schema can use it.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any, Literal

from udflow.checked import Strict, require
from udflow.neural_config import NetworkConfig, TrainingConfig

MAX_RESOLUTION = 1024
Extractor = Literal["edges", "cap"]
Guard = Literal["support", "none"]
FieldKind = Literal["spline", "mlp", "cap-udf"]


@dataclass(frozen=True)
class FlowConfig(Strict):
    """Trajectories. steps: K of the paper's time schedule."""

    steps: int = 5

    def __post_init__(self) -> None:
        require(1 <= self.steps <= 100, f"flow.steps is {self.steps}; choose 1 to 100 (paper: 5)")


@dataclass(frozen=True)
class SplineConfig(Strict):
    """The spline energy and its linear solve.

    resolution: cells of the finest grid along the largest extent; None chooses it from the
        estimated sample spacing.
    smoothness: weight of the third differences; None chooses it from the estimated noise.
    """

    resolution: int | None = None
    smoothness: float | None = None

    def __post_init__(self) -> None:
        if self.resolution is not None:
            require(
                8 <= self.resolution <= 512,
                f"spline.resolution is {self.resolution}; choose 8 to 512, or null for automatic",
            )
        if self.smoothness is not None:
            require(
                0.0 < self.smoothness <= 1e3,
                f"spline.smoothness is {self.smoothness}; choose a positive number up to 1000, "
                "or null for automatic",
            )


@dataclass(frozen=True)
class DensifyConfig(Strict):
    """Iterative densification, equation (9).

    target_points: stop at this many points; clouds that have as many are left alone.
    points_per_round: points added at a time (paper: 2 000); a trained field is then
        trained on, a solved one stays.
    threshold: epsilon, keep a projected point only where the field is below it; null keeps all.
    guard: "support" also wants measured points around it, so that nothing grows over a rim; "none"
        is the paper's way.
    """

    target_points: int = 30_000
    points_per_round: int = 15_000
    threshold: float | None = 0.005
    guard: Guard = "support"

    def __post_init__(self) -> None:
        require(
            0 <= self.target_points <= 5_000_000,
            f"densify.target_points is {self.target_points}; choose 0 (off) to 5000000",
        )
        require(
            100 <= self.points_per_round <= 1_000_000,
            f"densify.points_per_round is {self.points_per_round}; choose 100 to 1000000",
        )
        require(
            self.threshold is None or 0.0 < self.threshold <= 0.1,
            f"densify.threshold is {self.threshold}; choose a length above 0 and up to 0.1 "
            "(paper: 0.005), or null to keep every point",
        )
        require(
            self.guard in ("support", "none"),
            f'densify.guard is "{self.guard}"; choose "support" or "none"',
        )

    def require_above(self, points: int) -> None:
        """Refuses a target that so many points have passed already: densification only adds.

        Raises:
            InvalidConfig: fewer points are wanted than there are.
        """
        require(
            self.target_points >= points,
            f"densify.target_points is {self.target_points}, fewer than the {points} points of "
            "the cloud; raise it, set it to 0 to add none, or thin the cloud out",
        )


@dataclass(frozen=True)
class ExtractConfig(Strict):
    """From field to mesh.

    resolution: cells along the largest extent.
    extractor: "edges" decides once per grid edge and closes up; "cap" is the paper's per-cell
        marching, kept for its protocol.
    """

    resolution: int = 256
    extractor: Extractor = "edges"

    def __post_init__(self) -> None:
        require(
            16 <= self.resolution <= MAX_RESOLUTION,
            f"extract.resolution is {self.resolution}; choose 16 to {MAX_RESOLUTION}",
        )
        require(
            self.extractor in ("edges", "cap"),
            f'extract.extractor is "{self.extractor}"; choose "edges" or "cap"',
        )


@dataclass(frozen=True)
class Config(Strict):
    """Everything that decides a reconstruction. The same cloud, config and machine give the
    same mesh.

    field: "spline" solves linear systems; "mlp" trains the paper's network; "cap-udf" trains a
        distance network in the manner of CAP-UDF, to compare with.
    outliers: "drop" leaves out points that are scattered in space; "keep" takes all.
    """

    preset: str = "fast"
    field: FieldKind = "spline"
    outliers: str = "drop"
    flow: FlowConfig = dataclasses.field(default_factory=FlowConfig)
    spline: SplineConfig = dataclasses.field(default_factory=SplineConfig)
    network: NetworkConfig = dataclasses.field(default_factory=NetworkConfig)
    training: TrainingConfig = dataclasses.field(default_factory=TrainingConfig)
    densify: DensifyConfig = dataclasses.field(default_factory=DensifyConfig)
    extract: ExtractConfig = dataclasses.field(default_factory=ExtractConfig)
    seed: int = 0

    def __post_init__(self) -> None:
        require(
            self.preset in PRESET_NAMES,
            f'unknown preset "{self.preset}"; choose one of: {", ".join(PRESET_NAMES)}',
        )
        require(
            self.field in FIELDS,
            f'unknown field "{self.field}"; choose one of: {", ".join(FIELDS)}',
        )
        require(
            self.outliers in OUTLIERS,
            f'outliers is "{self.outliers}"; choose one of: {", ".join(OUTLIERS)}',
        )
        require(0 <= self.seed < 2**63, f"seed is {self.seed}; choose 0 to 2^63 - 1")


FIELDS: tuple[FieldKind, ...] = ("spline", "mlp", "cap-udf")
OUTLIERS = ("drop", "keep")
PRESET_NAMES = ("fast", "neural", "paper")
_NEURAL = {"field": "mlp"}
_PAPER = {
    "field": "mlp",
    "outliers": "keep",
    "network": NetworkConfig(
        layers=12,
        width=256,
        position_frequencies=5,
        time_frequencies=16,
        skips=(4, 8),
        film=(0, 4, 8),
        output="relu",
        scale="learned",
        start="linear",
    ),
    "training": TrainingConfig(
        iterations=60_000,
        batch=5_000,
        optimiser="adam",
        learning_rate=1e-3,
        warmup=1_000,
        queries=1_000_000,
        value_weight=0.0,
        sided=0,
        targets="points",
    ),
    "densify": DensifyConfig(points_per_round=2_000, guard="none"),
    "extract": ExtractConfig(extractor="cap"),
}
_CHANGES: dict[str, dict[str, Any]] = {"fast": {}, "neural": _NEURAL, "paper": _PAPER}


def preset(name: str) -> Config:
    """The configuration of a preset.

    Raises:
        InvalidConfig: there is no preset of this name.
    """
    require(
        name in PRESET_NAMES,
        f'unknown preset "{name}"; choose one of: {", ".join(PRESET_NAMES)}',
    )
    return Config(preset=name, **_CHANGES[name])


def require_target(config: Config, points: int) -> None:
    """Refuses a target, other than the preset's own and 0, that a cloud has passed already.

    Raises:
        InvalidConfig: it lies below the points of the cloud.
    """
    if config.densify.target_points not in (0, preset(config.preset).densify.target_points):
        config.densify.require_above(points)


def presets() -> dict[str, Config]:
    """All presets by name."""
    return {name: preset(name) for name in PRESET_NAMES}


def to_dict(config: Config) -> dict[str, Any]:
    """The configuration as plain JSON values."""
    return _plain(dataclasses.asdict(config))


def _plain(values: dict[str, Any]) -> dict[str, Any]:
    """With lists in place of tuples, which JSON does not know."""
    plain: dict[str, Any] = {}
    for key, value in values.items():
        if isinstance(value, dict):
            plain[key] = _plain(value)
        else:
            plain[key] = list(value) if isinstance(value, tuple) else value
    return plain


def from_dict(values: dict[str, Any]) -> Config:
    """A configuration from plain values: the preset's, changed where `values` says so.

    Raises:
        InvalidConfig: an unknown key, a wrong type or a value out of range.
    """
    name = values.get("preset", "fast")
    require(isinstance(name, str), "preset must be a string")
    return _updated(preset(name), values, "")


def _updated(base: Any, values: dict[str, Any], path: str) -> Any:
    known = {f.name: getattr(base, f.name) for f in dataclasses.fields(base)}
    changes: dict[str, Any] = {}
    for key, value in values.items():
        where = f"{path}{key}"
        require(
            key in known,
            f'unknown parameter "{where}"; known here: {", ".join(sorted(known))}',
        )
        current = known[key]
        if dataclasses.is_dataclass(current):
            require(isinstance(value, dict), f"{where} must be an object")
            changes[key] = _updated(current, value, f"{where}.")
        else:
            changes[key] = _checked_scalar(base, key, value, where)
    return dataclasses.replace(base, **changes)


def _checked_scalar(base: Any, key: str, value: Any, where: str) -> Any:
    annotation = str({f.name: f.type for f in dataclasses.fields(base)}[key])
    if value is None:
        require("None" in annotation, f"{where} must not be null")
        return None
    if annotation.startswith("int"):
        whole = isinstance(value, int) and not isinstance(value, bool)
        require(whole, f"{where} must be a whole number, not {value!r}")
    elif annotation.startswith("tuple[int"):
        return _checked_integers(value, where)
    elif annotation.startswith("float"):
        number = isinstance(value, int | float) and not isinstance(value, bool)
        require(number, f"{where} must be a number, not {value!r}")
        return float(value)
    else:
        require(isinstance(value, str), f"{where} must be a string, not {value!r}")
    return value


def _checked_integers(value: Any, where: str) -> tuple[int, ...]:
    whole = isinstance(value, list | tuple) and all(
        isinstance(item, int) and not isinstance(item, bool) for item in value
    )
    require(whole, f"{where} must be a list of whole numbers, not {value!r}")
    return tuple(value)
