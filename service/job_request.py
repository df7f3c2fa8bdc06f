"""From the wishes of a caller to the complete configuration of a job."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from service.bodies import parse_json, validated
from service.problems import Problem, invalid
from service.schemas import JobCreate
from udflow.config import PRESET_NAMES, from_dict, preset, require_target, to_dict
from udflow.errors import InvalidConfig

Path = tuple[str, ...]


def complete_config(preset_name: str, changes: dict[str, Any]) -> dict[str, Any]:
    """The preset's parameters, changed as asked, all checked.

    Raises:
        Problem: 422 with a pointer to every value that is wrong.
    """
    if preset_name not in PRESET_NAMES:
        known = ", ".join(PRESET_NAMES)
        message = f'unknown preset "{preset_name}"; choose one of: {known}'
        raise invalid("#/preset", "unknown_preset", message)
    if changes.get("preset", preset_name) != preset_name:
        message = "the preset is chosen beside config, not inside it"
        raise invalid("#/config/preset", "invalid_value", message)
    try:
        return to_dict(from_dict({**changes, "preset": preset_name}))
    except InvalidConfig as error:
        raise _explained(preset_name, changes, str(error)) from error


def require_suitable(config: dict[str, Any], scan: dict[str, Any]) -> None:
    """Refuses a complete configuration that a scan's manifest shows to be in vain.

    Raises:
        Problem: 422, more points are there already than densification is to end at.
    """
    try:
        require_target(from_dict(config), int(scan.get("unique_points") or 0))
    except InvalidConfig as error:
        raise invalid("#/config/densify/target_points", "invalid_value", str(error)) from error


def _explained(preset_name: str, changes: dict[str, Any], message: str) -> Problem:
    """Adds the changes one by one, so that the answer points at every one that is wrong; what only
    another change makes right (more layers, say) is tried again after that one."""
    good: dict[str, Any] = {"preset": preset_name}
    waiting = list(_leaves(changes))
    while True:
        wrong = []
        for path, value in waiting:
            try:
                from_dict(tried := _changed(good, path, value))
            except InvalidConfig as error:
                wrong.append((path, value, str(error)))
            else:
                good = tried
        if len(wrong) == len(waiting):
            break
        waiting = [(path, value) for path, value, _ in wrong]
    errors = []
    for path, _, reason in wrong:
        code = "invalid_value" if _is_known(preset_name, path) else "unknown_key"
        errors.append(("/".join(["#", "config", *map(_escaped, path)]), code, reason))
    if not errors:
        errors.append(("#/config", "invalid_value", message))
    detail = "; ".join(text for _, _, text in errors[:3])
    return Problem("invalid_request", detail, errors=errors[:20])


def _leaves(values: dict[str, Any], path: Path = ()) -> Iterator[tuple[Path, Any]]:
    for key, value in values.items():
        if isinstance(value, dict) and value and len(path) < 4:
            yield from _leaves(value, (*path, key))
        else:
            yield (*path, key), value


def _changed(values: dict[str, Any], path: Path, value: Any) -> dict[str, Any]:
    """A copy of nested values with one more."""
    key, *rest = path
    inner = values.get(key)
    below = inner if isinstance(inner, dict) else {}
    return {**values, key: _changed(below, tuple(rest), value) if rest else value}


def _is_known(preset_name: str, path: Path) -> bool:
    known: Any = to_dict(preset(preset_name))
    for key in path:
        if not isinstance(known, dict) or key not in known:
            return False
        known = known[key]
    return True


def _escaped(key: str) -> str:
    return key.replace("~", "~0").replace("/", "~1")


def form_values(fields: dict[str, str]) -> JobCreate:
    """The wish that came as parts of a form; what is no plain text is JSON there.

    Its scan_id is empty: the scan comes with the same form.

    Raises:
        Problem: an unknown part, or values that JobCreate refuses.
    """
    values: dict[str, Any] = dict(fields)
    if "scan_id" in values:
        message = "send either the file or a scan_id, not both"
        raise invalid("#/scan_id", "unknown_key", message)
    for name in ("config", "metadata", "outputs", "ttl_s"):
        if name in values:
            try:
                values[name] = parse_json(values[name])
            except Problem as error:
                raise invalid(f"#/{name}", "invalid_value", f"{name} must be JSON") from error
    return validated(JobCreate, {**values, "scan_id": ""})
