"""The page on the architecture names the packages, libraries and modules that there are."""

import re

from tests.code import ROOT
from tests.docs.tables import table_of
from tests.test_imports import FRONT, MAY_IMPORT, ONLY_IN

PAGE = ROOT / "docs" / "contributing" / "architecture.md"
FOLDERS = [ROOT, ROOT / "src" / "leapgap", ROOT / "conf"]


def test_every_package_has_its_row() -> None:
    rows = {name for row in table_of(PAGE, "| package | what it does |") for name in row[0].split(", ")}
    assert rows == {*(f"leapgap.{name}" for name in MAY_IMPORT), *FRONT, "stages"}


def test_libraries_are_in_the_packages_that_may_import_them() -> None:
    stated = {
        library: set(row[1].split(", ")) - {"stages"}
        for row in table_of(PAGE, "| library | only in |")
        for library in row[0].split(", ")
    }
    assert stated == ONLY_IN


def test_modules_that_are_named_exist() -> None:
    named = set(re.findall(r"`([a-z_0-9]+/[\w/.]+\.(?:py|xml|yaml))`", PAGE.read_text(encoding="utf-8")))
    assert len(named) > 50
    assert [name for name in sorted(named) if not any((folder / name).exists() for folder in FOLDERS)] == []
