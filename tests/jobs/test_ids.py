import time

import pytest

from jobs.errors import UnknownId
from jobs.ids import first_id, is_id, new_id, require_id


def test_ids_sort_by_creation_time() -> None:
    now = time.time()
    ids = [new_id("job", now + k / 100) for k in range(50)]
    assert sorted(ids) == ids
    assert ids[9] < first_id("job", now + 0.10) <= ids[10]


def test_ids_of_one_moment_differ_in_128_bits() -> None:
    ids = {new_id("scan", 1e9) for _ in range(200)}
    assert len(ids) == 200
    assert (
        len({text[15:21] for text in ids}) == 200
    )  # already 30 of the random bits tell them apart
    assert all(len(text) == len("scan_") + 36 for text in ids)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "job_",
        "../../etc/passwd",
        "job_" + "0" * 35,
        "job_" + "U" * 36,
        "job_" + "0" * 36 + "\n",
    ],
)
def test_anything_else_is_refused_in_words(text: str) -> None:
    assert not is_id("job", text)
    with pytest.raises(UnknownId, match="no such job"):
        require_id("job", text)


def test_a_scan_is_not_a_job() -> None:
    assert not is_id("job", new_id("scan"))
