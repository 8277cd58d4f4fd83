"""Programs that commands of the project call: DVC and git."""

import shutil

from leapgap.errors import InputError


def program(name: str) -> str:
    """The path of a program; ``InputError`` where there is none."""
    found = shutil.which(name)
    if found is None:
        do = "activate the project's environment: . .venv/bin/activate"
        raise InputError(name, "no such program", "a program on the path", do)
    return found
