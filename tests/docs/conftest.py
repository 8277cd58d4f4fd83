"""A folder in which the blocks of a page can run."""

import shutil
from pathlib import Path

import pytest

from tests.code import ROOT
from tests.project import Project


@pytest.fixture(scope="session")
def example(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the project, set to size tiny, with ``robot.xml`` and two simulated logs of it in ``logs/``.

    The robot that jumped has joint damping that ``robot.xml`` lacks. The same logs stand in ``data/jumps/damped``,
    where the pipeline has them.
    """
    project = Project(tmp_path_factory.mktemp("example") / "project")
    arguments = ("collect.hardware=damped", "collect.jumps=2", "collect.out=logs")
    project.run("python", "-m", "stages.collect", *arguments)
    (model,) = (project.folder / "src").rglob("a1.xml")
    shutil.copy(model, project.folder / "robot.xml")
    shutil.copytree(project.folder / "logs", project.folder / "data" / "jumps" / "damped")
    return project.folder


@pytest.fixture
def folder(example: Path, tmp_path: Path) -> Path:
    """A copy of the example for one page, which may write what it likes."""
    return Path(shutil.copytree(example, tmp_path / ROOT.name, ignore=shutil.ignore_patterns(".git")))
