from pathlib import Path

import pytest

from jobs.errors import BadSetting, NoRedisServer
from jobs.settings import Settings


def test_settings_come_from_the_environment(tmp_path: Path) -> None:
    found = Settings.from_env(
        {"UDFLOW_DATA": str(tmp_path), "REDIS_URL": "redis://h", "UDFLOW_LEASE_S": "7.5"}
    )
    assert (found.data, found.url, found.lease_s) == (tmp_path, "redis://h", 7.5)
    assert Settings.from_env({}) == Settings()
    with pytest.raises(NoRedisServer, match="make up"):
        _ = Settings().url


def test_a_device_of_no_kind_is_refused_in_words() -> None:
    assert Settings.from_env({"UDFLOW_DEVICE": "cuda:1"}).device == "cuda:1"
    with pytest.raises(BadSetting, match='choose "cpu"'):
        Settings.from_env({"UDFLOW_DEVICE": "gpu"})


@pytest.mark.parametrize("text", ["", "soon", "0", "-3", "nan", "inf"])
def test_a_duration_that_is_none_is_refused_in_words(text: str) -> None:
    with pytest.raises(BadSetting, match="UDFLOW_LEASE_S is"):
        Settings.from_env({"UDFLOW_LEASE_S": text})
