"""The one exception a user is meant to read."""


class InputError(Exception):
    """A file, log or setting that cannot be used; stages turn it into exit code 2 and its message.

    Says where the trouble is, what was found there, what was expected, and what to do about it, so that
    nobody needs a traceback to mend an input.
    """

    def __init__(self, where: object, found: str, expected: str, do: str) -> None:
        self.where, self.found, self.expected, self.do = str(where), found, expected, do
        self.do = do
        super().__init__(f"{where}: found {found}; expected {expected}; {do}")

    def __reduce__(self) -> tuple[type["InputError"], tuple[str, str, str, str]]:
        """To cross from a worker process to the one that tells the user."""
        return type(self), (self.where, self.found, self.expected, self.do)
