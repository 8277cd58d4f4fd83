"""dvc.yaml, params.yaml and conf/ against the code they describe."""

import re
from typing import Any

import pytest
from omegaconf import OmegaConf

from stages.params import compose_params, differences, is_as_written
from stages.repro import stage_names
from tests.code import ROOT, closure, dependency


def stages() -> dict[str, dict[str, Any]]:
    """Stages of dvc.yaml, one entry for a foreach stage."""
    raw = OmegaConf.to_container(OmegaConf.create((ROOT / "dvc.yaml").read_text().replace("${", "$ {")))
    return {name: stage.get("do", stage) for name, stage in raw["stages"].items()}  # type: ignore[index,union-attr]


def word(name: str) -> str:
    """The module of a stage, which is also its section: its name, or the beginning of it for a further use of one."""
    found = re.search(r"python -m stages\.(\w+)", stages()[name]["cmd"])
    assert found
    assert name == found[1] or name.startswith(f"{found[1]}_")
    return found[1]


@pytest.mark.parametrize("name", stages())
def test_stage_lists_the_code_it_runs_and_no_other(name: str) -> None:
    listed = {dep for dep in stages()[name]["deps"] if dep.startswith(("src/", "stages/"))}
    needed = {dependency(module) for module in closure(f"stages.{word(name)}")} - {
        "stages/__init__.py",
        "src/leapgap/__init__.py",
        "src/leapgap/jumping/__init__.py",
    }
    assert listed == needed


@pytest.mark.parametrize("name", stages())
def test_rule_of_one_word(name: str) -> None:
    stage, section = stages()[name], word(name)
    assert stage["desc"]
    if section != "params":
        assert section in stage["params"]
        assert (ROOT / "conf" / section).is_dir()


def test_params_yaml_equals_the_composed_configuration() -> None:
    text = (ROOT / "params.yaml").read_text(encoding="utf-8")
    assert text == compose_params(), "run `dvc repro params` and commit params.yaml"


def test_params_knows_an_edit_by_hand_from_an_old_file() -> None:
    old = compose_params(["chunk.steps=9"])
    assert is_as_written(old)
    assert not is_as_written(old.replace("steps: 9", "steps: 8"))
    found = differences({"a": {"b": 1, "c": 2}}, {"a": {"b": 3, "c": 2}})
    assert found == ["a.b: 1 in params.yaml, 3 in conf/"]


def test_the_lock_holds_no_stage_that_is_gone() -> None:
    """DVC reads and writes the whole lock after every stage, which takes it a second for 7000 lines."""
    lock = OmegaConf.to_container(OmegaConf.load(ROOT / "dvc.lock"))
    assert set(lock["stages"]) <= set(stage_names(ROOT / "dvc.yaml"))  # type: ignore[index,call-overload,arg-type]


def test_every_grid_that_lands_has_models_of_its_own_steps() -> None:
    """The pipeline trains the grids that are landed with by default, and `make full` the others."""
    land = OmegaConf.load(ROOT / "conf/land/default.yaml")
    raw = OmegaConf.to_container(OmegaConf.create((ROOT / "dvc.yaml").read_text().replace("${", "$ {")))
    steps = {f"data/models/{name}": of["grid"] for name, of in raw["stages"]["chunk"]["foreach"].items()}  # type: ignore[index,call-overload]
    by_make = re.findall(r"^STEPS_(\w+) := (.*)", (ROOT / "Makefile").read_text(), re.MULTILINE)
    steps |= {f"data/models/simulated_{name}": grid for name, grid in by_make}
    for name, folder in land.models.items():
        made = compose_params(steps[folder].split())
        chunk, grid = OmegaConf.create(made).chunk, land.grids[name]
        assert {key: chunk[key] for key in grid} == grid


def test_every_size_composes() -> None:
    for path in (ROOT / "conf" / "size").glob("*.yaml"):
        assert compose_params([f"size={path.stem}"])
