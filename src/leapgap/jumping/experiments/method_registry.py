"""Landing methods by name: every class in ``methods``, and the instances that ``conf/land`` configures."""

from collections.abc import Mapping
from dataclasses import MISSING, fields
from functools import cache

from leapgap.jumping.experiments import methods
from leapgap.jumping.experiments.methods.base import MethodSettings
from leapgap.registry import classes_by_name

ENTRY_POINTS = "leapgap.landing_methods"
"""Entry-point group under which other packages provide methods."""


@cache
def known() -> dict[str, type[MethodSettings]]:
    """Classes of methods by their names, in alphabetical order."""
    return classes_by_name(methods, MethodSettings, ENTRY_POINTS)  # type: ignore[type-abstract]


def available(configured: Mapping[str, MethodSettings]) -> dict[str, MethodSettings]:
    """Methods by the names they can be asked for: those configured, and every class that needs no configuration."""
    return {name: kind() for name, kind in known().items() if has_only_defaults(kind)} | dict(configured)


def has_only_defaults(kind: type[MethodSettings]) -> bool:
    """Whether all settings of a class have defaults."""
    return all(field.default is not MISSING or field.default_factory is not MISSING for field in fields(kind))
