"""The one exception a user is meant to read."""

import difflib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager


class InputError(Exception):
    """A file, log or setting that cannot be used; stages turn it into exit code 2 and its message.

    Says where the trouble is, what was found there, what was expected, and what to do about it, so that
    nobody needs a traceback to mend an input.
    """

    def __init__(self, where: object, found: str, expected: str, do: str) -> None:
        self.where, self.found, self.expected, self.do = str(where), found, expected, do
        super().__init__(f"{where}: found {found}; expected {expected}; {do}")

    def __reduce__(self) -> tuple[type["InputError"], tuple[str, str, str, str]]:
        """To cross from a worker process to the one that tells the user."""
        return type(self), (self.where, self.found, self.expected, self.do)


def did_you_mean(word: str, known: Iterable[str]) -> str | None:
    """A question that names the known word nearest to one that is not known; None where none is near."""
    near = difflib.get_close_matches(word, list(known), 1)
    return f"did you mean {near[0]}?" if near else None


@contextmanager
def needs(extra: str) -> Iterator[None]:
    """Stand around imports of packages that an extra of ours installs, inside the function that uses them.

    A package that is missing becomes an ``InputError`` that names the extra; a missing module of our own stays a
    ``ModuleNotFoundError``.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        name = error.name or str(error)
        if name.partition(".")[0] == "leapgap":
            raise
        raise InputError(
            f"import of {name}",
            "no package of that name",
            f"what the extra '{extra}' installs",
            f"pip install 'leapgap[{extra}]'",
        ) from None
