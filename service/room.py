"""The room that is kept free on the disk, so that what was accepted can also be finished."""

from __future__ import annotations

from service.problems import Problem
from service.services import Services


def require_room(services: Services, coming_bytes: int = 0) -> None:
    """Refuses what would leave less than UDFLOW_MIN_FREE_MB on the disk.

    Raises:
        Problem: 507.
    """
    if coming_bytes > services.store.free_bytes() - services.settings.min_free_bytes:
        raise Problem(
            "storage_full",
            "There is no room left on the disk of the service; nothing of this request was kept, "
            "and what was there before is still there. Try again when there is more room.",
        )
