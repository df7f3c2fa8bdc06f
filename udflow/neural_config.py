"""Parameters of the fields that are trained: the network and its training. Imports no torch."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from udflow.checked import Strict, require

Output = Literal["abs", "relu", "softplus"]
Start = Literal["linear", "he", "sphere"]
Targets = Literal["points", "quadrics"]
Precision = Literal["float32", "tf32", "bfloat16"]
Optimiser = Literal["adam", "muon"]
PullLoss = Literal["chamfer", "points"]
Scale = Literal["learned", "ideal"]

OUTPUTS: tuple[Output, ...] = ("abs", "relu", "softplus")
STARTS: tuple[Start, ...] = ("linear", "he", "sphere")
TARGETS: tuple[Targets, ...] = ("points", "quadrics")
PRECISIONS: tuple[Precision, ...] = ("float32", "tf32", "bfloat16")
SCALES: tuple[Scale, ...] = ("learned", "ideal")
OPTIMISERS: tuple[Optimiser, ...] = ("adam", "muon")
PULL_LOSSES: tuple[PullLoss, ...] = ("chamfer", "points")


def _one_of(name: str, value: str, known: tuple[str, ...]) -> None:
    choice = ", ".join(f'"{k}"' for k in known)
    require(value in known, f'{name} is "{value}"; choose one of: {choice}')


@dataclass(frozen=True)
class NetworkConfig(Strict):
    """The network of section III-C. Layers are numbered from 0.

    layers, width: L and H.
    position_frequencies: F of equation (6); 0 leaves the position as it is.
    time_frequencies: D of equation (7); 0 leaves the time as it is.
    skips: layers whose input has the embedded position joined to it.
    film: layers whose input is scaled and shifted by the time; none makes the field the same at
        all times.
    film_width: of both hidden layers between the time and these scales and shifts; null makes them
        as wide as the network.
    activation: of the hidden layers. Only "relu": the gradient by hand uses that it is linear in
        pieces.
    output: activation of the scalar d: "relu" is the paper's, "abs" cannot die.
    scale: how d grows with time: the paper leaves it to the network ("learned"); "ideal" divides
        the output by the square root of t, as the ideal d = dist / sqrt(t) does.
    start: initial weights: "linear" is what linear layers usually start with, "he" keeps the
        variance through rectified layers, "sphere" starts with a faint distance from
        a sphere.
    """

    layers: int = 8
    width: int = 128
    position_frequencies: int = 5
    time_frequencies: int = 16
    skips: tuple[int, ...] = (4,)
    film: tuple[int, ...] = (0, 4)
    film_width: int | None = None
    activation: Literal["relu"] = "relu"
    output: Output = "abs"
    scale: Scale = "ideal"
    start: Start = "linear"

    def __post_init__(self) -> None:
        require(1 <= self.layers <= 64, f"network.layers is {self.layers}; choose 1 to 64")
        require(4 <= self.width <= 4096, f"network.width is {self.width}; choose 4 to 4096")
        require(
            self.film_width is None or 4 <= self.film_width <= 4096,
            f"network.film_width is {self.film_width}; choose 4 to 4096, or null for network.width",
        )
        for name in ("position_frequencies", "time_frequencies"):
            value = getattr(self, name)
            require(0 <= value <= 64, f"network.{name} is {value}; choose 0 (off) to 64")
        self._check_places("skips", first=1)
        self._check_places("film", first=0)
        _one_of("network.activation", self.activation, ("relu",))
        _one_of("network.output", self.output, OUTPUTS)
        _one_of("network.scale", self.scale, SCALES)
        _one_of("network.start", self.start, STARTS)

    def _check_places(self, name: str, first: int) -> None:
        places = getattr(self, name)
        require(
            all(first <= p < self.layers for p in places) and len(set(places)) == len(places),
            f"network.{name} is {list(places)}; choose different layers from {first} to "
            f"{self.layers - 1}",
        )


@dataclass(frozen=True)
class TrainingConfig(Strict):
    """Training on equation (3).

    iterations: of all fits together. With rounds of densification the first fit gets half of
        them, the rounds share the rest.
    batch: trajectories an iteration, spread evenly over the times t_1..t_K.
    optimiser: "adam" is the paper's; "muon" turns the updates of square matrices into orthogonal
        ones, and gets out of flat starts much sooner.
    learning_rate: the highest, after `warmup` iterations; then it falls like a cosine to zero.
    queries: trajectories drawn before a fit, and used again and again.
    spread: standard deviation of queries around their sample, in distances to its 50th neighbour.
    value_weight: of (d - sqrt(t) |x_1 - x_0|)^2 beside equation (3); the paper has none.
    sided: iterations (at most a third) in which a first fit with network.output "abs" also learns
        on which side of the surface a query lies, by a sign guessed from the data; 0 is the
        paper's, which leaves it to chance.
    far: share of the queries drawn from the whole box instead.
    targets: where trajectories end: "points" is the paper's nearest sample, "quadrics" the nearest
        point of local quadrics fitted to the samples.
    pull_loss: for field "cap-udf" only: "chamfer" compares the moved batch with the batch of
        nearest samples as two sets, "points" pair by pair.
    precision: of matrix products. "tf32" and "bfloat16" are for CUDA; sums stay in float32.
    """

    iterations: int = 5_000
    batch: int = 2_000
    optimiser: Optimiser = "muon"
    learning_rate: float = 2e-3
    warmup: int = 200
    queries: int = 400_000
    spread: float = 0.25
    value_weight: float = 0.0
    sided: int = 300
    far: float = 0.0
    targets: Targets = "quadrics"
    pull_loss: PullLoss = "chamfer"
    precision: Precision = "float32"

    def __post_init__(self) -> None:
        self._check_whole("iterations", 1, 10_000_000)
        self._check_whole("batch", 100, 1_000_000)
        self._check_whole("warmup", 0, 1_000_000)
        self._check_whole("queries", 1_000, 100_000_000)
        self._check_whole("sided", 0, 1_000_000)
        require(
            0.0 < self.learning_rate <= 1.0,
            f"training.learning_rate is {self.learning_rate}; choose a number above 0 and up to 1 "
            "(paper: 0.001)",
        )
        require(
            0.0 < self.spread <= 10.0,
            f"training.spread is {self.spread}; choose a number above 0 and up to 10",
        )
        require(
            0.0 <= self.value_weight <= 1e3,
            f"training.value_weight is {self.value_weight}; choose 0 (off) to 1000",
        )
        require(0.0 <= self.far <= 1.0, f"training.far is {self.far}; choose a share, 0 to 1")
        _one_of("training.optimiser", self.optimiser, OPTIMISERS)
        _one_of("training.targets", self.targets, TARGETS)
        _one_of("training.pull_loss", self.pull_loss, PULL_LOSSES)
        _one_of("training.precision", self.precision, PRECISIONS)

    def _check_whole(self, name: str, low: int, high: int) -> None:
        value = getattr(self, name)
        require(low <= value <= high, f"training.{name} is {value}; choose {low} to {high}")
