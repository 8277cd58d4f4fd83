"""The page of licences names every package that pyproject.toml asks for, and every other that is not permissive."""

import importlib.metadata
import re
import sysconfig
import tomllib

from tests.code import ROOT

PAGE = (ROOT / "docs" / "contributing" / "licences.md").read_text(encoding="utf-8")
ROWS = [row.split("|") for row in PAGE.splitlines() if row.startswith("|")]
LISTED = {name.strip(): row[2] for row in ROWS for name in row[1].split(",")}
RECIPROCAL = re.compile(r"\b(A?L?GPL|General Public|EPL|MPL|Mozilla|ZPL|Zope|EUPL|CC-BY-SA)")


def asked_for() -> set[str]:
    """Names of all requirements of the project, those of its extras included."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras = project["optional-dependencies"].values()
    lines = project["dependencies"] + [line for extra in extras for line in extra]
    return {re.split(r"[^A-Za-z0-9_.-]", line)[0] for line in lines} - {"leapgap"}


def stated(metadata: importlib.metadata.PackageMetadata) -> str:
    """What a package's metadata say of its licence, without the texts of whole licences."""
    classifiers = [line for line in metadata.get_all("Classifier") or [] if line.startswith("License")]
    return " ".join([metadata.get("License-Expression") or "", (metadata.get("License") or "")[:60], *classifiers])


def test_every_requirement_is_listed() -> None:
    assert asked_for() - set(LISTED) == set()


def test_what_is_not_permissive_is_listed_as_such() -> None:
    """Of the packages that the installed extras bring, without those that a package holds for itself."""
    places = {sysconfig.get_path(which) for which in ("purelib", "platlib")}
    for package in importlib.metadata.distributions(path=list(places)):
        if RECIPROCAL.search(stated(package.metadata)):
            name = package.metadata["Name"]
            assert name in LISTED, f"{name} ({stated(package.metadata)}) is missing in docs/contributing/licences.md"
            assert RECIPROCAL.search(LISTED[name]), f"docs/contributing/licences.md calls {name} permissive"
