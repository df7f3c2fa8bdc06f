"""Table VII: parameters, operations, seconds; the gradient by hand beside automatic ones.

    python benchmarks/paper/table7_complexity.py --save

All networks are timed in this one process, hand and autograd in turns, in process time.
"""

from __future__ import annotations

import argparse
import dataclasses
from typing import Any

import torch
from lab import markdown, provenance, provenance_line, save, timed
from torch import Tensor

from udflow.config import Config, from_dict, preset
from udflow.fields import reference
from udflow.fields.mlp import MLPField
from udflow.fields.network import Network, started
from udflow.fit.objectives import trajectory_objective
from udflow.fit.queries import Trajectories
from udflow.fit.training import Trainer, learning_rate
from udflow.flow.schedule import TimeSchedule
from udflow.flow.trajectory import interpolate, trajectory_loss

HEADER = (
    "network", "batch", "parameters", "GFLOP/it by hand", "GFLOP/it autograd", "s/it by hand",
    "s/it autograd", "times faster", "same losses", "h for 60 000", "s for 10⁶ queries",
)  # fmt: skip
CAP = {"field": "cap-udf", "network": {"layers": 8, "width": 256, "film": [], "skips": [4],
       "position_frequencies": 0, "scale": "learned"}, "training": {"batch": 5_000}}  # fmt: skip
NETWORKS: dict[str, Config] = {
    "paper, 12x256": preset("paper"),
    "neural, 8x128": preset("neural"),
    "no time, 8x256 as CAP-UDF": from_dict({"preset": "neural", **CAP}),
}
PAPER = (
    "The paper (RTX 4090): 1.0 M parameters, 59.3 GFLOP, 14.5 min of training, 53.9 s for a grid "
    "of queries; CAP-UDF there: 0.5 M, 27.5 GFLOP, 9.4 min, 15.6 s."
)


class ByAutograd:
    """The paper's network as it is written, double back-propagation, torch's Adam."""

    def __init__(self, trainer: Trainer, config: Config, ends: Trajectories, rows: Tensor) -> None:
        self.network, self.config, self.ends, self.rows = trainer.network, config, ends, rows
        self.parameters = trainer.parameters.clone().requires_grad_()
        self.optimiser = torch.optim.Adam([self.parameters], eps=1e-15)
        times = torch.tensor(TimeSchedule(config.flow.steps).times)
        self.t = times.repeat_interleave(rows.shape[1] // len(times))[:, None]
        self.losses: list[float] = []

    def step(self) -> None:
        """One iteration."""
        rows = self.rows[len(self.losses)]
        query, foot = self.ends.query[rows], self.ends.foot[rows]
        rate = learning_rate(len(self.losses), len(self.rows), self.config.training)
        self.optimiser.param_groups[0]["lr"] = rate
        self.optimiser.zero_grad()
        weights = self.network.views(self.parameters)
        v = reference.velocity(self.network, weights, interpolate(query, foot, self.t), self.t)
        loss = trajectory_loss(v, query, foot)
        loss.backward()
        self.optimiser.step()
        self.losses.append(float(loss.detach()))


def main() -> None:
    """Time every network."""
    options = _options()
    origin = provenance(threads=torch.get_num_threads(), iterations=options.iterations)
    rows = [measured(name, NETWORKS[name], options.iterations) for name in NETWORKS]
    text = (
        "# Table VII: complexity\n\nProcess seconds per thread, both ways in one run. FLOP are "
        "those of matrix products: four per matrix by hand, six by automatic double "
        "differentiation.\n\n"
        f"{markdown(HEADER, [_cells(row) for row in rows])}\n{PAPER}\n\n{provenance_line(origin)}\n"
    )
    print(text)
    if options.save:
        save("paper_table7_complexity", {**origin, "rows": rows}, text)


def measured(name: str, config: Config, iterations: int) -> dict[str, Any]:
    """One row."""
    training = dataclasses.replace(config.training, optimiser="adam", iterations=iterations + 2)
    config = dataclasses.replace(config, training=training)
    network = Network(config.network)
    generator = torch.Generator().manual_seed(0)
    foot = 0.5 * torch.nn.functional.normalize(torch.randn(50_000, 3, generator=generator), dim=1)
    ends = Trajectories(foot + 0.01 * torch.randn(50_000, 3, generator=generator), foot, 0.017)
    trainer = Trainer(
        network, started(network, generator), ends, TimeSchedule(config.flow.steps),
        trajectory_objective(config.network.output), training, iterations + 2, generator,
    )  # fmt: skip
    plan = _plan(trainer, iterations + 2)
    autograd = ByAutograd(trainer, config, ends, plan)
    losses: list[float] = []

    def by_hand() -> None:
        with torch.inference_mode():
            trainer._index.copy_(plan[trainer.iteration])
            rate = learning_rate(trainer.iteration, iterations + 2, training)
            trainer.optimiser.prepare(rate)
            trainer._loss.zero_()
            trainer._one_step()
            trainer.iteration += 1
            losses.append(float(trainer._loss))

    hand_s, autograd_s = timed(by_hand, iterations), timed(autograd.step, iterations)
    apart = max(abs(a / b - 1) for a, b in zip(losses, autograd.losses, strict=True))
    return {
        "network": name, "batch": trainer._rows, "parameters": network.size,
        "gflop": network.flops(trainer._rows) / 1e9,
        "gflop_autograd": network.flops(trainer._rows, passes=6) / 1e9,
        "s": hand_s, "s_autograd": autograd_s, "losses_apart": apart,
        "s_million_queries": _query_seconds(config, trainer),
    }  # fmt: skip


def _plan(trainer: Trainer, iterations: int) -> Tensor:
    """(iterations, rows) rows of the batches, the same for both."""
    generator = torch.Generator().manual_seed(1)
    return torch.randint(50_000, (iterations, trainer._rows), generator=generator)


def _query_seconds(config: Config, trainer: Trainer) -> float:
    """Process seconds per thread of a million projections, from some thousands."""
    schedule = TimeSchedule(config.flow.steps if config.network.film else 1)
    field = MLPField(config.network, schedule, trainer.parameters, 1.0, 1.5)
    points = torch.rand(8_192, 3) - 0.5
    with torch.inference_mode():
        return timed(lambda: field.project(points), 3) * 1e6 / len(points)


def _cells(row: dict[str, Any]) -> list[str]:
    return [
        row["network"], str(row["batch"]), f"{row['parameters']:,}", f"{row['gflop']:.1f}",
        f"{row['gflop_autograd']:.1f}", f"{row['s']:.4f}", f"{row['s_autograd']:.4f}",
        f"{row['s_autograd'] / row['s']:.2f}", f"within {row['losses_apart']:.1e}",
        f"{row['s'] * 60_000 / 3600:.1f}", f"{row['s_million_queries']:.1f}",
    ]  # fmt: skip


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--iterations", type=int, default=20, help="timed, of each kind")
    parser.add_argument("--budget", type=float, help="accepted and not needed: nothing is trained")
    parser.add_argument("--save", action="store_true", help="write docs/results")
    return parser.parse_args()


if __name__ == "__main__":
    main()
