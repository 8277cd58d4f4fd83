"""Foreign logs to jump logs: one module a format, found by its file name.

A format is a module with a dataclass ``Options`` and two functions: ``find(source)`` lists the jumps of a folder as
``{name: path}``, ``read(path, name, robot, options)`` turns one into a ``Jump``. Adding a format is adding a file.
"""

import pkgutil
from importlib import import_module
from types import ModuleType

from leapgap.errors import InputError


def formats() -> tuple[str, ...]:
    """Names of the known formats."""
    return tuple(sorted(module.name for module in pkgutil.iter_modules(__path__)))


def importer(name: str) -> ModuleType:
    """The importer of a format; an unknown name is an ``InputError``."""
    if name not in formats():
        raise InputError("import_logs.format", name, f"one of {', '.join(formats())}", "choose a known format")
    return import_module(f"{__name__}.{name}")
