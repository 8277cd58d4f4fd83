"""The package as others get it: its metadata, and the wheel in an empty environment."""

import json
import os
import re
import shutil
import subprocess
import sys
import tarfile
import tomllib
from collections.abc import Sequence
from email import message_from_string
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from omegaconf import OmegaConf
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from tests import plain_arm
from tests.code import ROOT

pytestmark = pytest.mark.long

PACKAGED = ("src", "pyproject.toml", "README.md", "LICENSE")
BESIDE = ("MANIFEST.in", "CHANGELOG.md", "CITATION.cff", "constraints.txt")
"""What the source distribution holds besides."""


@cache
def project() -> dict[str, Any]:
    return tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


@cache
def pins() -> dict[str, str]:
    """Exact version of each package in constraints.txt by its canonical name."""
    lines = (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()
    pairs = [line.split("==") for line in lines if line and not line.startswith("#")]
    return {canonicalize_name(name): version for name, version in pairs}


def requirements() -> list[str]:
    return [*project()["dependencies"], *(r for extra in project()["optional-dependencies"].values() for r in extra)]


@pytest.mark.parametrize("text", sorted(set(requirements())))
def test_every_requirement_is_pinned_within_its_range(text: str) -> None:
    requirement = Requirement(text)
    if requirement.name == project()["name"]:
        assert requirement.extras <= set(project()["optional-dependencies"])
    else:
        assert requirement.specifier.contains(pins()[canonicalize_name(requirement.name)])


def test_the_guide_lists_every_extra() -> None:
    page = (ROOT / "docs" / "how-to" / "install.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| (`[^|]+) \|", page, re.MULTILINE)
    assert {name.strip("` ") for row in rows for name in row.split(",")} == set(project()["optional-dependencies"])


def test_changelog_and_citation_are_of_this_version() -> None:
    version = project()["version"]
    headings = re.findall(r"^## \[([^\]]+)\]", (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), re.MULTILINE)
    assert next(heading for heading in headings if heading != "Unreleased") == version
    assert str(OmegaConf.load(ROOT / "CITATION.cff").version) == version


def run(*command: str | Path, cwd: Path) -> str:
    """Standard output of a command that sees neither this environment's packages nor the working tree."""
    unseen = ("PYTHONPATH", "PYTHONHOME", "VIRTUAL_ENV")
    environment = {key: value for key, value in os.environ.items() if key not in unseen}
    done = subprocess.run(
        [str(word) for word in command], cwd=cwd, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, f"{command}\n{done.stdout[-3000:]}{done.stderr[-3000:]}"
    return done.stdout


def copy_sources(names: Sequence[str], folder: Path) -> None:
    """Copy files and folders of the project, without what running or installing it left there."""
    for name in names:
        if (ROOT / name).is_dir():
            shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("__pycache__", "*.egg-info"))
        else:
            shutil.copy(ROOT / name, folder / name)


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Built from a copy, so that no build folder stays in the working tree."""
    source, out = tmp_path_factory.mktemp("source"), tmp_path_factory.mktemp("wheel")
    copy_sources(PACKAGED, source)
    run(sys.executable, "-m", "pip", "wheel", "-q", "--no-deps", "-w", out, source, cwd=out)
    (built,) = out.glob("*.whl")
    return built


@pytest.fixture(scope="module")
def python(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The interpreter of an environment that holds the wheel and its base dependencies."""
    folder = tmp_path_factory.mktemp("venv")
    run(sys.executable, "-m", "venv", folder / "venv", cwd=folder)
    interpreter = folder / "venv" / "bin" / "python"
    only_what_is_imported = "--no-compile"  # Python compiles the rest when it is needed, which is never
    run(
        *(interpreter, "-m", "pip", "install", "-q", only_what_is_imported),
        *("-c", ROOT / "constraints.txt", wheel),
        cwd=folder,
    )
    return interpreter


@pytest.mark.pipeline
def test_wheel_holds_every_file_of_the_package_and_its_licence(wheel: Path, python: Path, tmp_path: Path) -> None:
    run(sys.executable, "-m", "zipfile", "-e", wheel, tmp_path, cwd=tmp_path)
    packed = {str(path.relative_to(tmp_path)) for path in (tmp_path / "leapgap").rglob("*") if path.is_file()}
    tracked = run("git", "ls-files", "-co", "--exclude-standard", "src/leapgap", cwd=ROOT).split()
    assert packed == {name.removeprefix("src/") for name in tracked if (ROOT / name).exists()}
    (about,) = tmp_path.glob("leapgap-*.dist-info")
    metadata = message_from_string((about / "METADATA").read_text(encoding="utf-8"))
    assert metadata["Version"] == project()["version"]
    assert metadata["License-Expression"] == "MIT"
    assert (about / "licenses" / "LICENSE").read_text(encoding="utf-8") == (ROOT / "LICENSE").read_text(
        encoding="utf-8"
    )


@pytest.mark.pipeline
def test_the_source_distribution_holds_the_package_and_no_part_of_the_tests(tmp_path: Path) -> None:
    """Tests need the whole project; setuptools would take those that stand beside each other in ``tests/``."""
    pytest.importorskip("setuptools")
    copy_sources([*PACKAGED, *BESIDE], tmp_path)
    (tmp_path / "tests").mkdir()
    shutil.copy(__file__, tmp_path / "tests")
    run(sys.executable, "-c", "from setuptools import build_meta; build_meta.build_sdist('dist')", cwd=tmp_path)
    (built,) = (tmp_path / "dist").glob("*.tar.gz")
    with tarfile.open(built) as archive:
        held = {name.partition("/")[2] for name in archive.getnames() if ".egg-info" not in name}
    tracked = run("git", "ls-files", "-co", "--exclude-standard", "src/leapgap", cwd=ROOT).split()
    assert {name for name in tracked if (ROOT / name).exists()} | {*PACKAGED, *BESIDE} <= held
    assert not [name for name in held if name.startswith("tests")]


@pytest.mark.pipeline
def test_base_install_brings_no_package_of_the_extras(python: Path, tmp_path: Path) -> None:
    listed = json.loads(run(python, "-m", "pip", "list", "--format=json", cwd=tmp_path))
    extras = {canonicalize_name(Requirement(r).name) for r in requirements()} - {
        canonicalize_name(Requirement(r).name) for r in project()["dependencies"]
    }
    assert {canonicalize_name(package["name"]) for package in listed} & (extras - {"leapgap"}) == set()


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with ``arm.xml`` and two logs of the arm in ``logs``, by plain MuJoCo."""
    folder = tmp_path_factory.mktemp("arm")
    plain_arm.write_model(folder)
    plain_arm.write_parquet(folder / "logs", logs=2)
    return folder


@pytest.mark.pipeline
def test_two_logs_are_diagnosed_by_command_in_an_empty_environment(python: Path, arm: Path) -> None:
    command = python.with_name("leapgap")
    said = run(command, "diagnose", "logs", "arm.xml", "--out", "out", "--quiet", cwd=arm)
    assert said.startswith("named: viscous friction (joint_damping at elbow: damping ")
    report = json.loads((arm / "out" / "report.json").read_text(encoding="utf-8"))
    assert report["answer"] == [["joint_damping"]]
    damping = report["causes"][0]["parameters"]["damping"]["value"]
    assert damping == pytest.approx(plain_arm.TRUE - plain_arm.BELIEVED, rel=0.02)
    assert (arm / "out" / "report.html").is_file()
    assert not (arm / "out" / "diagnosis.rrd").exists()  # recordings come with an extra
    assert run(command, "--version", cwd=arm) == f"leapgap {project()['version']}\n"
