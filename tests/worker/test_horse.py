"""The process of a job: where it stands among the others of the machine."""

from __future__ import annotations

import os
import sys

import pytest
from workshop import LONG, Workshop, horse_of


@pytest.mark.skipif(sys.platform != "linux", reason="priorities of other processes")
def test_a_fit_gives_way_to_the_api_and_to_its_own_worker(shop: Workshop) -> None:
    job_id = shop.submit(LONG)
    fit = shop.is_fitting(job_id)
    own = os.getpriority(os.PRIO_PROCESS, 0)  # the worker was started from here
    assert os.getpriority(os.PRIO_PROCESS, horse_of(fit)) == min(19, own + 10)
    shop.records.request_cancel(job_id)
