"""Registries of classes by name: those in the files of one package, and those that other packages offer."""

import pkgutil
from importlib import import_module
from importlib.metadata import entry_points
from types import ModuleType
from typing import TypeVar

from leapgap.errors import InputError

Kind = TypeVar("Kind")
LONGEST_MESSAGE = 300  # characters of another package's own message that are repeated


def classes_by_name(package: ModuleType, base: type[Kind], group: str) -> dict[str, type[Kind]]:
    """Subclasses of ``base`` by their ``name``, in alphabetical order.

    Every file of ``package`` is imported, so that a new class needs only a new file. Other installed packages offer
    classes under the entry point group ``group``; one that cannot be loaded is an ``InputError`` that names it.
    """
    for module in pkgutil.iter_modules(package.__path__):
        import_module(f"{package.__name__}.{module.name}")
    of_package = [kind for kind in subclasses(base) if kind.__module__.startswith(f"{package.__name__}.")]
    found = [kind for kind in of_package if hasattr(kind, "name")]  # the others are bases of several
    for point in entry_points(group=group):
        try:
            kind = point.load()
        except (ImportError, AttributeError) as error:
            expected = f"a class, offered as {group}"
            raise InputError(point.value, f"nothing to import ({error})", expected, "repair or remove it") from None
        except Exception as error:  # whatever the code of another package raises while it is imported
            says = " ".join(str(error).split())[:LONGEST_MESSAGE]
            fault = f"code that fails while it is imported ({type(error).__name__}: {says})"
            raise InputError(point.value, fault, f"a class, offered as {group}", "repair or remove it") from error
        if not (isinstance(kind, type) and issubclass(kind, base)):
            raise InputError(point.value, repr(kind), f"a subclass of {base.__name__}", "correct its entry point")
        if missing := ", ".join(sorted(getattr(kind, "__abstractmethods__", ()))):
            raise InputError(point.value, f"no {missing}", f"all of {base.__name__}", "write them")
        if not isinstance(getattr(kind, "name", None), str):
            raise InputError(point.value, "no name", "a text as name of the class", "give it one")
        found.append(kind)
    by_name: dict[str, type[Kind]] = {}
    for kind in found:
        if by_name.setdefault(kind.name, kind) is not kind:  # type: ignore[attr-defined]
            where = f"{kind.__module__}.{kind.__qualname__}"
            raise InputError(where, f"the name {kind.name}", "a name of its own", "choose another")  # type: ignore[attr-defined]
    return dict(sorted(by_name.items()))


def subclasses(base: type[Kind]) -> list[type[Kind]]:
    """All classes below ``base`` that can be instantiated, in the order of their definition."""
    found = []
    for kind in base.__subclasses__():
        if not getattr(kind, "__abstractmethods__", None):
            found.append(kind)
        found += subclasses(kind)
    return found
