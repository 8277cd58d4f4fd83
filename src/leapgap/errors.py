"""The one exception a user is meant to read."""

import difflib
import re
from collections.abc import Iterable, Iterator
from contextlib import contextmanager

CONTROL = re.compile("[\x00-\x1f\x7f-\x9f\u2028\u2029\u202a-\u202e\u2066-\u2069\ud800-\udfff]")
"""Characters that end a line, move the cursor, set colours or turn the direction of a text, and what is no text."""


def printable(text: object) -> str:
    """A text of somebody else as it is printed or written, on one line: control characters become their codes."""
    return CONTROL.sub(
        lambda found: f"\\x{ord(found[0]):02x}" if found[0] < "\u0100" else f"\\u{ord(found[0]):04x}", str(text)
    )


class InputError(Exception):
    """A file, log or setting that cannot be used; stages turn it into exit code 2 and its message.

    Says where the trouble is, what was found there, what was expected, and what to do about it, so that nobody needs a
    traceback to correct an input. What of it comes from a file is made ``printable``. ``each`` are further lines, one
    for each of several troubles.
    """

    def __init__(self, where: object, found: str, expected: str, do: str, each: Iterable[object] = ()) -> None:
        self.where, self.found, self.expected, self.do = map(printable, (where, found, expected, do))
        self.each = tuple(map(printable, each))
        lines = "".join(f"\n  {line}" for line in self.each)
        listed = f":{lines}\n " if lines else ""
        super().__init__(f"{self.where}: found {self.found}{listed}; expected {self.expected}; {self.do}")

    def __reduce__(self) -> tuple[type["InputError"], tuple[str, str, str, str, tuple[str, ...]]]:
        """To cross from a worker process to the one that shows it to the user."""
        return type(self), (self.where, self.found, self.expected, self.do, self.each)


def check_utf8(path: object) -> None:
    """``InputError`` for a path that is no UTF-8, which the libraries that open files cannot take."""
    try:
        str(path).encode()
    except UnicodeEncodeError:
        raise InputError(path, "a path that is not UTF-8", "a path that is", "rename the file or folder") from None


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
