"""Any order of creating, claiming, canceling, crashing and finishing, against a model."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, ClassVar

import pytest
from hypothesis import HealthCheck
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st
from hypothesis.stateful import (
    RuleBasedStateMachine,
    initialize,
    invariant,
    precondition,
    rule,
    run_state_machine_as_test,
)

from jobs import keys
from jobs.events import Events
from jobs.ids import new_id
from jobs.records import MAX_CRASHES, JobRecords
from jobs.settings import Settings
from jobs.spec import TERMINAL, JobSpec, JobState

# relative to the current attempt: mostly its own worker, sometimes a lost one or a forged one
OFFSETS = st.sampled_from([0, 0, 0, 0, -1, 1])


class Model:
    """What one job should be, in plain Python."""

    def __init__(self) -> None:
        self.states = ["queued"]
        self.attempt = 1
        self.crashes = 0

    @property
    def state(self) -> str:
        return self.states[-1]

    def holds(self, attempt: int) -> bool:
        return attempt == self.attempt and self.state in ("running", "canceling")

    def lose(self, crashed: bool) -> None:
        self.crashes += crashed and self.state != "canceling"
        if self.state == "canceling":
            self.states.append("canceled")
        elif self.crashes >= MAX_CRASHES:
            self.states.append("failed")
        else:
            self.attempt += 1
            self.states.append("queued")


class JobLife(RuleBasedStateMachine):
    connection: ClassVar[Any]

    @initialize(start=st.sampled_from(["queued", "running", "running", "canceling"]))
    def create(self, start: str) -> None:
        self.records = JobRecords(self.connection)
        self.events = Events(self.connection)
        self.model = Model()
        self.id = self.records.create(JobSpec.new(new_id("scan"), {})).record.id
        if start != "queued":
            self.claim(0)
        if start == "canceling":
            self.cancel()

    @precondition(lambda self: self.model.state == "queued")
    @rule()
    def start_again(self) -> None:
        self.claim(0)

    @rule(offset=OFFSETS)
    def claim(self, offset: int) -> None:
        attempt = self.model.attempt + offset
        allowed = self.model.state == "queued" and attempt == self.model.attempt
        assert (self.records.claim(self.id, attempt) is not None) == allowed
        if allowed:
            self.model.states.append("running")

    @rule(offset=OFFSETS)
    def step(self, offset: int) -> None:
        attempt = self.model.attempt + offset
        moved = self.records.update(self.id, attempt, ("progress", {}), progress=0.5)
        assert moved == self.model.holds(attempt)

    @rule(offset=OFFSETS, state=st.sampled_from([JobState.SUCCEEDED, JobState.FAILED]))
    def finish(self, offset: int, state: Any) -> None:
        attempt = self.model.attempt + offset
        held = self.model.holds(attempt)
        reached = self.records.finish(self.id, attempt, state)
        if held:
            expected = "canceled" if self.model.state == "canceling" else str(state)
            self.model.states.append(expected)
            assert reached == expected

    @rule()
    def cancel(self) -> None:
        self.records.request_cancel(self.id)
        if self.model.state == "queued":
            self.model.states.append("canceled")
        elif self.model.state == "running":
            self.model.states.append("canceling")

    @rule(offset=OFFSETS, crashed=st.booleans())
    def die(self, offset: int, crashed: bool) -> None:
        attempt = self.model.attempt + offset
        current = attempt == self.model.attempt
        possible = current and JobState(self.model.state) not in TERMINAL
        after = self.records.requeue(self.id, attempt, crashed=crashed, why="died")
        assert (after is not None) == possible
        if possible:
            self.model.lose(crashed)

    @precondition(lambda self: self.model.state in ("running", "canceling"))
    @rule()
    def lease_expires(self) -> None:
        JobRecords(self.connection, lease_s=-1.0).renew_lease(self.id, self.model.attempt)
        assert self.id in [record.id for record in self.records.expired_leases()]
        self.records.requeue(
            self.id, self.model.attempt, crashed=True, only_expired=True, why="lost"
        )
        self.model.lose(crashed=True)

    @invariant()
    def the_record_is_the_model(self) -> None:
        record = self.records.get(self.id)
        assert record is not None
        assert (record.state, record.attempt) == (self.model.state, self.model.attempt)

    @invariant()
    def every_state_was_told_once_and_in_order(self) -> None:
        told = self.events.read(self.id, count=5000)
        assert [e.data["state"] for e in told if e.type == "state"] == self.model.states
        ends = [e for e in told if e.type == "end"]
        assert len(ends) == (JobState(self.model.state) in TERMINAL)
        assert not ends or told[-1] == ends[0]

    @invariant()
    def the_sets_agree_with_the_state(self) -> None:
        waits = self.connection.zscore(keys.QUEUED, self.id) is not None
        leased = self.connection.zscore(keys.LEASES, self.id) is not None
        assert waits == (self.model.state == "queued")
        assert leased == (self.model.state in ("running", "canceling"))


@pytest.fixture
def machine(settings: Settings) -> Iterator[type[JobLife]]:
    JobLife.connection = settings.connect()
    yield JobLife
    JobLife.connection.close()


def test_a_job_has_one_life(machine: type[JobLife]) -> None:
    run_state_machine_as_test(  # type: ignore[no-untyped-call]
        machine,
        settings=hypothesis_settings(
            max_examples=80,
            stateful_step_count=15,
            deadline=None,
            suppress_health_check=list(HealthCheck),
            derandomize=True,
            database=None,
        ),
    )
