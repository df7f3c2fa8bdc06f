"""A sparse set of integer lattice points with constant-time look-up."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from udflow.compiled import over_rows
from udflow.fields.lattice_loops import find_rows

BLOCK = 8  # lattice points along the edge of a leaf block
_LEAF = BLOCK**3


@dataclass(frozen=True)
class SparseLattice:
    """Active points of a lattice of `shape` points, numbered block by block.

    A dense table names the leaf blocks, each leaf names its 8^3 points: two gathers answer a
    look-up, and memory follows the number of active blocks, not the volume.

    Attributes:
        shape: lattice points along each axis.
        coordinates: (n, 3) int64, the active points in the order of their numbers.
        table: (bx, by, bz) int32, number of the leaf or 0, the empty leaf.
        leaves: (leaves + 1, 512) int32, number of the active point or -1.
    """

    shape: tuple[int, int, int]
    coordinates: Tensor
    table: Tensor
    leaves: Tensor

    @classmethod
    def from_mask(cls, mask: Tensor) -> SparseLattice:
        """The lattice of the true entries of a (nx, ny, nz) bool volume."""
        nx, ny, nz = mask.shape
        return cls.from_distinct(mask.nonzero(), (nx, ny, nz))

    @classmethod
    def from_distinct(cls, coordinates: Tensor, shape: tuple[int, int, int]) -> SparseLattice:
        """The lattice of (n, 3) int64 points that are distinct and inside `shape`."""
        device = coordinates.device
        blocks = tuple(-(-s // BLOCK) for s in shape)
        block, local = _keys(coordinates, blocks)
        table = torch.zeros(blocks, dtype=torch.int32, device=device)
        table.view(-1)[block] = 1
        occupied = table.view(-1).nonzero().squeeze(1)
        table.view(-1)[occupied] = torch.arange(
            1, len(occupied) + 1, dtype=torch.int32, device=device
        )
        leaves = torch.full((len(occupied) + 1, _LEAF), -1, dtype=torch.int32, device=device)
        leaves.view(-1)[table.view(-1)[block].long() * _LEAF + local] = torch.arange(
            len(coordinates), dtype=torch.int32, device=device
        )
        return cls(shape, coordinates, table, leaves)

    def __len__(self) -> int:
        return len(self.coordinates)

    def find(self, coordinates: Tensor) -> Tensor:
        """Numbers of lattice points.

        Args:
            coordinates: (..., 3) int64.

        Returns:
            (...) int64, -1 where the point is not active or outside the lattice.
        """
        by = self.find_by_loop if coordinates.device.type == "cpu" else self.find_by_tensors
        return by(coordinates)

    def find_by_loop(self, coordinates: Tensor) -> Tensor:
        """`find` on the CPU."""
        rows = coordinates.reshape(-1, 3).contiguous()
        number = torch.empty(len(rows), dtype=torch.int64)
        arrays = np.array(self.shape), self.table.numpy(), self.leaves.numpy(), number.numpy()
        over_rows(find_rows, len(rows), rows.numpy(), *arrays)
        return number.view(coordinates.shape[:-1])

    def find_by_tensors(self, coordinates: Tensor) -> Tensor:
        """`find` on any device."""
        x, y, z = coordinates.unbind(dim=-1)
        nx, ny, nz = self.shape
        inside = (x >= 0) & (x < nx) & (y >= 0) & (y < ny) & (z >= 0) & (z < nz)
        x, y, z = x.clamp(0, nx - 1), y.clamp(0, ny - 1), z.clamp(0, nz - 1)
        block, local = _keys(torch.stack([x, y, z], dim=-1), tuple(self.table.shape))
        leaf = self.table.view(-1)[block].long()
        number = self.leaves.view(-1)[leaf * _LEAF + local].long()
        return torch.where(inside, number, -1)

    def dilated(self, radius: int) -> SparseLattice:
        """The lattice grown by `radius` points in every direction (a cube of 2 radius + 1)."""
        mask = self._mask()
        for _ in range(radius):
            mask = _grown(mask)
        return SparseLattice.from_mask(mask)

    def _mask(self) -> Tensor:
        mask = torch.zeros(self.shape, dtype=torch.bool, device=self.coordinates.device)
        x, y, z = self.coordinates.unbind(dim=1)
        mask[x, y, z] = True
        return mask


def occupied_mask(coordinates: Tensor, shape: tuple[int, int, int]) -> Tensor:
    """(nx, ny, nz) bool volume that is true at the (m, 3) int64 coordinates inside `shape`."""
    mask = torch.zeros(shape, dtype=torch.bool, device=coordinates.device)
    bounds = torch.tensor(shape, device=coordinates.device)
    inside = ((coordinates >= 0) & (coordinates < bounds)).all(dim=1)
    x, y, z = coordinates[inside].unbind(dim=1)
    mask[x, y, z] = True
    return mask


def neighbour_offsets(device: torch.device | str = "cpu") -> Tensor:
    """The 27 offsets of a lattice point's neighbourhood, (27, 3) int64, x slowest."""
    axis = torch.arange(-1, 2, device=device)
    return torch.cartesian_prod(axis, axis, axis)


def _grown(mask: Tensor) -> Tensor:
    for axis in range(3):
        n = mask.shape[axis]
        grown = mask.clone()
        grown.narrow(axis, 1, n - 1).logical_or_(mask.narrow(axis, 0, n - 1))
        grown.narrow(axis, 0, n - 1).logical_or_(mask.narrow(axis, 1, n - 1))
        mask = grown
    return mask


def _keys(coordinates: Tensor, blocks: tuple[int, ...]) -> tuple[Tensor, Tensor]:
    """Linear number of the block and of the point inside its block."""
    x, y, z = coordinates.unbind(dim=-1)
    block = ((x >> 3) * blocks[1] + (y >> 3)) * blocks[2] + (z >> 3)
    return block, ((x & 7) << 6) | ((y & 7) << 3) | (z & 7)
