"""What configuration objects have in common: they refuse what they do not know."""

from __future__ import annotations

from typing import Any, ClassVar

from udflow.errors import InvalidConfig


def require(condition: bool, message: str) -> None:
    """Refuses a parameter.

    Raises:
        InvalidConfig: with the message, where the condition does not hold.
    """
    if not condition:
        raise InvalidConfig(message)


class Strict:
    """Unknown keys are refused wherever pydantic builds one of these objects."""

    __pydantic_config__: ClassVar[dict[str, Any]] = {"extra": "forbid"}
