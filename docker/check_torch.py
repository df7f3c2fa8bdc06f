"""Fail the build when the index has served another PyTorch than was asked for.

check_torch.py cpu|cuda
"""

from __future__ import annotations

import sys

REMEDY = {
    "cpu": "pass --build-arg TORCH_INDEX_URL with the index of PyTorch's CPU builds (several GB "
    "smaller), or --build-arg ACCELERATOR=cuda to keep this one",
    "cuda": "pass --build-arg TORCH_INDEX_URL with the index of PyTorch's CUDA builds, or "
    "--build-arg ACCELERATOR=cpu to do without",
}


def verdict(wanted: str, cuda: str | None) -> str | None:
    """What is wrong, or None. cuda: the CUDA version that torch was built with, if any."""
    if wanted not in REMEDY:
        return f'ACCELERATOR is "{wanted}"; choose one of: {", ".join(REMEDY)}'
    found = "cpu" if cuda is None else "cuda"
    if found == wanted:
        return None
    return (
        f"the index served a {found} build of torch where {wanted} was asked for: {REMEDY[wanted]}"
    )


if __name__ == "__main__":
    import torch

    sys.exit(verdict(sys.argv[1], torch.version.cuda))
