"""The logs of tests/reports, for the recordings of jumps."""

from tests.reports.conftest import ghost, hop

__all__ = ["ghost", "hop"]
