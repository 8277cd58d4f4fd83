"""The table of checks has every check, and no other."""

import re

from leapgap.diagnosis import checks
from tests.code import ROOT


def test_every_check_stands_in_the_table() -> None:
    text = (ROOT / "docs" / "reference" / "checks.md").read_text()
    named = {name for row in re.findall(r"^\| (`.*?) \|", text, re.MULTILINE) for name in re.findall(r"`(\w+)`", row)}
    assert named == {kind.name for kind in checks.known()}
