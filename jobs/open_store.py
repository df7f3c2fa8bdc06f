"""The store that the settings name."""

from __future__ import annotations

from pathlib import Path
from urllib.parse import unquote, urlsplit

from jobs.errors import BadSetting
from jobs.settings import Settings
from jobs.store import FileStore


def open_store(settings: Settings) -> FileStore:
    """Files in the data folder, in the folder of a file:// address, or in an s3:// bucket.

    Raises:
        BadSetting: STORE_URL is of another kind, or obstore is not installed.
    """
    url = settings.store_url
    if url is None:
        return FileStore(settings.data)
    parts = urlsplit(url)
    if parts.scheme == "file" and parts.path:
        return FileStore(Path(unquote(parts.path)))
    if parts.scheme != "s3" or not parts.netloc:
        raise BadSetting(
            "STORE_URL must be file:///folder or s3://bucket/prefix; without it files lie in "
            "UDFLOW_DATA"
        )
    try:
        from jobs.object_store import ObjectStore
    except ModuleNotFoundError as error:
        raise BadSetting("s3 needs obstore; pip install 'udflow[s3]'") from error
    return ObjectStore(url, settings.data)
