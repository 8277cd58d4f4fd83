"""Landing methods: one file each, found by its file name; configured instances are listed in ``conf/land``."""

import pkgutil
from collections.abc import Mapping
from dataclasses import MISSING, fields
from functools import cache
from importlib import import_module

from leapgap.experiment.methods.base import MethodSettings


@cache
def known() -> dict[str, type[MethodSettings]]:
    """Classes of methods by their names, in alphabetical order."""
    for module in pkgutil.iter_modules(__path__):
        import_module(f"{__name__}.{module.name}")
    kinds = [kind for kind in MethodSettings.__subclasses__() if kind.__module__.startswith(f"{__name__}.")]
    return {kind.name: kind for kind in sorted(kinds, key=lambda kind: kind.name)}


def available(configured: Mapping[str, MethodSettings]) -> dict[str, MethodSettings]:
    """Methods by the names they can be asked for: those configured, and every class that needs no configuration."""
    return {name: kind() for name, kind in known().items() if needs_nothing(kind)} | dict(configured)


def needs_nothing(kind: type[MethodSettings]) -> bool:
    """Whether all settings of a class have defaults."""
    return all(field.default is not MISSING or field.default_factory is not MISSING for field in fields(kind))
