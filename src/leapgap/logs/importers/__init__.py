"""Importers of other log formats: one file a format, or several that are alike."""

import sys
from functools import cache

from leapgap.errors import InputError, did_you_mean
from leapgap.logs.importers.base import LogFormat
from leapgap.registry import classes_by_name

ENTRY_POINTS = "leapgap.log_formats"  # entry point group under which other packages register formats


@cache
def formats() -> dict[str, type[LogFormat]]:
    """The known formats by name."""
    return classes_by_name(sys.modules[__name__], LogFormat, ENTRY_POINTS)  # type: ignore[type-abstract]


def log_format(name: str) -> LogFormat:
    """A format by name; an unknown one is an ``InputError``."""
    if name not in formats():
        do = did_you_mean(name, formats()) or "choose a known format"
        raise InputError("format", name, f"one of {', '.join(formats())}", do)
    return formats()[name]()
