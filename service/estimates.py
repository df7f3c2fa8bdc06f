"""What a job would take, and whether there is enough of it."""

from __future__ import annotations

from dataclasses import asdict, replace
from typing import Any

from jobs.costs import Costs, Estimate, Workload
from service.problems import Problem
from service.schemas import CostEstimate
from service.services import Services

_SMALLEST = 16


def estimated(
    scan: dict[str, Any], config: dict[str, Any], kind: str, services: Services
) -> tuple[Workload, Estimate]:
    """The cost of a job for a scan's manifest and a complete configuration."""
    workload = Workload.of(scan, config, kind)
    return workload, Costs(services.redis).estimate(workload)


def require_affordable(
    scan: dict[str, Any], config: dict[str, Any], kind: str, services: Services
) -> Estimate:
    """The estimate of a job that can be run here.

    Raises:
        Problem: 422, even the lower bounds are beyond the machine's memory or the longest run
            allowed; `largest` is the resolution of extraction that would do, None if none would.
    """
    workload, estimate = estimated(scan, config, kind, services)
    costs = Costs(services.redis)
    memory = costs.machine_memory(workload)
    limits = {"seconds": services.longest_run_s, "memory_bytes": memory}
    if (reason := _too_much(estimate, limits)) is None:
        return estimate
    largest = next(
        (
            resolution
            for resolution in range(workload.resolution // 16 * 16, _SMALLEST - 1, -16)
            if _too_much(costs.estimate(_at(workload, resolution)), limits) is None
        ),
        None,
    )
    remedy, pointer = _remedy(workload, largest)
    raise Problem(
        "job_too_costly",
        f"The job needs {reason}; {remedy}.",
        errors=[(pointer, "too_costly", f"{reason}; {remedy}")],
        largest=largest,
        estimate=view(estimate).model_dump(mode="json"),
    )


def _remedy(workload: Workload, largest: int | None) -> tuple[str, str]:
    """What would help, in words, and the parameter that it is about."""
    if largest:
        return f"extract.resolution {largest} would do", "#/config/extract/resolution"
    if workload.is_trained:
        return "lower training.iterations or choose another preset", "#/config/training/iterations"
    return "send fewer points, or densify less", "#/config/extract/resolution"


def view(estimate: Estimate) -> CostEstimate:
    """As the API shows it."""
    basis = (
        f"the last {estimate.jobs} jobs of this kind here"
        if estimate.jobs
        else "a reference machine; it becomes exact with the first jobs here"
    )
    return CostEstimate(**asdict(estimate), basis=basis)


def _at(workload: Workload, resolution: int) -> Workload:
    return replace(workload, resolution=resolution, cells=min(workload.cells, float(resolution)))


def _too_much(estimate: Estimate, limits: dict[str, float | None]) -> str | None:
    seconds, memory = limits["seconds"], limits["memory_bytes"]
    if seconds is not None and estimate.seconds.low > seconds:
        return (
            f"at least {estimate.seconds.low:.0f} s, and a job may run {seconds:.0f} s here "
            "(UDFLOW_JOB_TIMEOUT_S)"
        )
    if memory is not None and estimate.memory_bytes.low > memory:
        needed, there = (int(x) >> 20 for x in (estimate.memory_bytes.low, memory))
        return f"at least {needed} MB of memory, and there are {there} MB"
    return None
