"""A folder in which the blocks of a page can run."""

import shutil
from pathlib import Path

import pytest

from tests.code import ROOT
from tests.project import Project


@pytest.fixture(scope="session")
def example(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the project, set to size tiny, with ``robot.xml`` and four logs of that robot in ``logs/``.

    The robot is the arm of the guide, simulated by plain MuJoCo: its elbow has damping that ``robot.xml`` lacks.
    """
    project = Project(tmp_path_factory.mktemp("example") / "project")
    project.run("python", "docs/examples/arm_logs.py", ".")
    return project.folder


@pytest.fixture
def folder(example: Path, tmp_path: Path) -> Path:
    """A copy of the example for one page, which may write what it likes."""
    return Path(shutil.copytree(example, tmp_path / ROOT.name, ignore=shutil.ignore_patterns(".git")))
