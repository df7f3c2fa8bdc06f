"""A fit on disk, to be gone on with: tensors as safetensors, the rest as JSON in their header."""

from __future__ import annotations

import hashlib
import json
import os
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save as to_bytes
from torch import Tensor

from udflow.config import Config, to_dict
from udflow.errors import BadCheckpoint
from udflow.fit.neural import NeuralFitting

FORMAT = "udflow-checkpoint"
VERSION = 1
_TENSORS = {"parameters", "mean", "square", "order", "counts", "rate_scale", "samples", "generator"}


def origin_of(cloud: Tensor, config: Config) -> str:
    """Fingerprint of (n, 3) points and a configuration."""
    digest = hashlib.sha256(json.dumps(to_dict(config), sort_keys=True).encode())
    digest.update(cloud.cpu().contiguous().numpy().tobytes())
    return digest.hexdigest()


@dataclass(frozen=True)
class Checkpoint:
    """Where a reconstruction stood.

    Attributes:
        origin: fingerprint of cloud and configuration; a checkpoint fits no other.
        rounds: counters of every round of densification so far.
        trainer: state of the fit under way, of `Trainer.state`.
        samples: (n, 3) the points it is fitted to, unit frame.
        generator: state of the random numbers when the fit began.
    """

    origin: str
    rounds: tuple[dict[str, int], ...]
    trainer: dict[str, Tensor]
    samples: Tensor
    generator: Tensor

    def save(self, path: Path) -> None:
        """Writes it in place of what is there; a reader sees the old file or the new one."""
        tensors = {**self.trainer, "samples": self.samples, "generator": self.generator}
        header = {
            "format": FORMAT,
            "version": VERSION,
            "origin": self.origin,
            "rounds": list(self.rounds),
        }
        content = to_bytes(
            {name: tensor.cpu().contiguous() for name, tensor in tensors.items()},
            metadata={"udflow": json.dumps(header)},
        )
        part = path.with_name(path.name + ".part")
        with part.open("wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        part.replace(path)

    @classmethod
    def load(cls, path: Path, origin: str) -> Checkpoint:
        """Reads a checkpoint of the same cloud and configuration.

        Raises:
            BadCheckpoint: damaged, of another version, or of another cloud or configuration.
        """
        try:
            with safe_open(str(path), framework="pt") as file:
                header = json.loads((file.metadata() or {}).get("udflow", "{}"))
                tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
        except (SafetensorError, ValueError, OSError) as error:
            raise BadCheckpoint(_unreadable(path, str(error))) from error
        _check(path, header, tensors, origin)
        samples, generator = tensors.pop("samples"), tensors.pop("generator")
        return cls(origin, tuple(header["rounds"]), tensors, samples, generator)


class Keeper:
    """Saves fits to a file now and then, and hands back the one that was found there.

    Args:
        path: the file.
        every_s: least time between two savings.
        origin: fingerprint of cloud and configuration.

    Raises:
        BadCheckpoint: the file is damaged, or of another origin.
    """

    def __init__(self, path: Path, every_s: float, origin: str) -> None:
        self._path, self._every_s, self._origin = path, every_s, origin
        self._saved = time.monotonic()
        self.stored = Checkpoint.load(path, origin) if path.exists() else None

    def resume(self, fitting: object) -> None:
        """Puts a fit that has just begun where the stored one was; the first fit only.

        Raises:
            BadCheckpoint: the stored network has another size.
        """
        stored, self.stored = self.stored, None
        if stored is not None and isinstance(fitting, NeuralFitting):
            fitting.trainer.restore(stored.trainer)

    def offer(
        self,
        fitting: object,
        rounds: tuple[dict[str, int], ...],
        samples: Tensor,
        generator: Tensor,
    ) -> None:
        """Saves a trained fit, unless it was saved a moment ago."""
        due = time.monotonic() - self._saved >= self._every_s
        if due and isinstance(fitting, NeuralFitting):
            state = fitting.trainer.state()
            Checkpoint(self._origin, rounds, state, samples, generator).save(self._path)
            self._saved = time.monotonic()

    def remove(self) -> None:
        """Removes the file: the field is whole."""
        self._path.unlink(missing_ok=True)


def _check(path: Path, header: Any, tensors: dict[str, Tensor], origin: str) -> None:
    if not isinstance(header, dict) or header.get("format") != FORMAT:
        raise BadCheckpoint(_unreadable(path, "it is no checkpoint of udflow"))
    if header.get("version") != VERSION:
        raise BadCheckpoint(_unreadable(path, f"it has version {header.get('version')}"))
    if header.get("origin") != origin:
        raise BadCheckpoint(
            f"{path.name} was saved for another cloud or other parameters; give those, or name "
            "another file to start anew"
        )
    rounds, samples = header.get("rounds"), tensors.get("samples")
    if set(tensors) != _TENSORS or samples is None or samples.ndim != 2 or samples.shape[1] != 3:
        raise BadCheckpoint(_unreadable(path, "it is not complete"))
    if not isinstance(rounds, list) or not all(_is_counts(counts) for counts in rounds):
        raise BadCheckpoint(_unreadable(path, "its rounds are not counted"))
    if not all(bool(torch.isfinite(t).all()) for t in tensors.values() if t.is_floating_point()):
        raise BadCheckpoint(_unreadable(path, "it holds numbers that are not finite"))


def _is_counts(counts: Any) -> bool:
    if not isinstance(counts, dict) or not all(isinstance(n, int) for n in counts.values()):
        return False
    return {"round", "points", "added"} <= set(counts) and counts["added"] >= 0


def _unreadable(path: Path, reason: str) -> str:
    return f"cannot go on from {path.name}: {reason}; remove the file to start anew"
