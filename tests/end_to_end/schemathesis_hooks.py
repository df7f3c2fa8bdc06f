"""Loaded by schemathesis: bodies of types it does not know by itself."""

import schemathesis

for media_type in ("application/offset+octet-stream", "application/x-npy"):
    schemathesis.serializer.alias(media_type, "application/octet-stream")
