"""The record of which code made the figures that DVC does not make."""

import re
from pathlib import Path

import pytest
import yaml
from omegaconf import OmegaConf

from leapgap.errors import InputError
from leapgap.runtime.atomic_io import read_json
from stages import made_with
from tests.code import ROOT, TREE
from tests.project import Project

OTHER = {"metrics/made_with.json", "metrics/timing/stages.json"}
"""The record itself, and the times that ``make run`` shows."""


def made_by_dvc() -> set[str]:
    """Files of figures that the pipelines make."""
    conf = OmegaConf.load(ROOT / "params.yaml")
    texts = [(ROOT / name).read_text(encoding="utf-8") for name in ("dvc.yaml", "published/dvc.yaml")]
    by_variant = [run.metrics for of in conf.variants.values() for run in of.values() if "metrics" in run]
    return {*by_variant, *re.findall(r"metrics/[\w/]+\.json(?=: \{cache)", "\n".join(texts))}


def test_frozen_stages_hold_every_file_of_figures_that_no_pipeline_makes() -> None:
    stages = yaml.safe_load((ROOT / "figures/dvc.yaml").read_text(encoding="utf-8"))["stages"]
    frozen = {name for stage in stages.values() for one in stage["metrics"] for name in one}
    assert frozen == {name for name in made_with.CODE if (ROOT / name).is_file()}


def test_every_file_of_figures_has_a_record() -> None:
    files = {path.relative_to(ROOT).as_posix() for path in (ROOT / "metrics").rglob("*.json")}
    assert files - made_by_dvc() - set(made_with.CODE) == OTHER


def test_the_code_of_every_file_of_figures_is_there() -> None:
    for code in made_with.CODE.values():
        assert [path for path in code if "/" in path and not (ROOT / path).exists()] == []
        assert made_with.files_of(ROOT, code, TREE)


def test_code_of_a_module_is_all_that_it_imports() -> None:
    found = made_with.files_of(ROOT, [made_with.DIAGNOSIS], TREE)
    files = {path.relative_to(ROOT).as_posix() for path in found}
    assert {"src/leapgap/effects/friction.py", "src/leapgap/simulation/replay.py"} <= files
    assert "src/leapgap/cli.py" not in files and "src/leapgap/logs/importers/csv.py" not in files


def test_what_is_noted_is_of_files_that_are_known_and_there() -> None:
    for name in read_json(ROOT / made_with.NOTED):
        assert name in made_with.CODE
        assert (ROOT / name).is_file()


def test_a_change_of_code_makes_figures_older_and_another_file_does_not(tmp_path: Path) -> None:
    name = "metrics/timing/optimize.json"
    project = Project.__new__(Project)
    project.folder = tmp_path
    planner = tmp_path / "src/leapgap/jumping/planning/solve.py"
    for path in (planner, tmp_path / name):
        path.parent.mkdir(parents=True)
        path.write_text("{}")
    project.git("init", "-q")
    project.commit("start")

    def state() -> str:
        return made_with.state(tmp_path, name, made_with.modules(tmp_path))

    assert state() == "unknown"
    made_with.note(tmp_path, [name])
    assert state() == "as it stands"
    assert (
        read_json(tmp_path / made_with.NOTED)[name]["commit"] == project.git("rev-parse", "--short=10", "HEAD").strip()
    )
    planner.with_name("readme.md").write_text("other")
    assert state() == "as it stands"
    planner.write_text("{}  # a comment")
    assert state() == "as it stands"
    planner.write_text("{1: 1}")
    assert state() == "older"
    made = read_json(tmp_path / made_with.NOTED)[name]["commit"]
    project.git("commit", "-qam", "a set more")
    made_with.note(tmp_path, [name], unchanged="a set that nobody reads does nothing")
    assert state() == "unchanged"
    assert read_json(tmp_path / made_with.NOTED)[name]["commit"] == made
    assert made_with.files_by_reason(tmp_path, [name]) == {"a set that nobody reads does nothing": [name]}
    assert f"- `{name}` unchanged: a set that nobody reads does nothing." in made_with.markdown(tmp_path)
    planner.write_text("{2: 2}")
    assert state() == "older"
    made_with.note(tmp_path, [name])
    assert state() == "as it stands"
    planner.rename(planner.with_name("other.py"))
    assert state() == "older"
    (tmp_path / name).unlink()
    assert state() == "absent"


def test_only_figures_that_are_known_and_there_are_noted(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="blind"):
        made_with.note(tmp_path, ["metrics/blnd.json"])
    with pytest.raises(InputError, match="make it first"):
        made_with.note(tmp_path, ["metrics/blind.json"])
    (tmp_path / "metrics").mkdir()
    (tmp_path / "metrics/blind.json").write_text("{}")
    with pytest.raises(InputError, match="make it again"):
        made_with.note(tmp_path, ["metrics/blind.json"], unchanged="it must be so")
    assert not (tmp_path / made_with.NOTED).exists()
