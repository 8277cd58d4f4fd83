"""dvc.yaml, params.yaml, plans/ and conf/ against the code they describe."""

import re
from pathlib import Path
from typing import Any

import pytest
import yaml
from omegaconf import OmegaConf

from stages import compose
from stages.code import stage_modules
from stages.compose import compose_conf, compose_params, differences, is_as_written, plans_of
from stages.repro import stage_names
from tests.code import ROOT

PIPELINES = ("dvc.yaml", "published/dvc.yaml")


def stages(pipeline: str = "dvc.yaml") -> dict[str, dict[str, Any]]:
    """Stages of a pipeline, one entry for a foreach stage."""
    raw = yaml.safe_load((ROOT / pipeline).read_text(encoding="utf-8"))
    return {name: stage.get("do", stage) for name, stage in raw["stages"].items()}


STAGES = [(pipeline, name) for pipeline in PIPELINES for name in stages(pipeline)]


def word(pipeline: str, name: str) -> str:
    """The module of a stage, which is also its section: its name, or the beginning of it for a further use of one."""
    found = re.search(r"python -m stages\.(\w+)", stages(pipeline)[name]["cmd"])
    assert found
    assert name == found[1] or name.startswith(f"{found[1]}_")
    return found[1]


@pytest.mark.parametrize(("pipeline", "name"), STAGES)
def test_a_stage_depends_on_what_its_code_means_and_on_no_file_of_code(pipeline: str, name: str) -> None:
    deps = stages(pipeline)[name].get("deps", [])
    assert not [dep for dep in deps if dep.endswith(".py")]
    if name != "code":
        assert f"data/code/{word(pipeline, name)}.json" in deps


@pytest.mark.parametrize(("pipeline", "name"), STAGES)
def test_rule_of_one_word(pipeline: str, name: str) -> None:
    stage, section = stages(pipeline)[name], word(pipeline, name)
    assert stage["desc"]
    if section not in ("code", "params"):
        assert section in {key.partition(".")[0] for key in stage["params"]}
        assert (ROOT / "conf" / section).is_dir()


@pytest.mark.parametrize(("pipeline", "name"), STAGES)
def test_a_stage_depends_on_the_plans_that_it_reads(pipeline: str, name: str) -> None:
    """Plans are no parameters, so that a stage whose section has some names their file."""
    deps, section = stages(pipeline)[name].get("deps", []), word(pipeline, name)
    planned = {"practise": ("collect", "land"), "land": ("collect", "land"), "revisit": ()}
    for plan in planned.get(section, (section,) if section in compose.PLANNED else ()):
        assert f"plans/{plan}.yaml" in deps


@pytest.mark.parametrize("name", stage_modules())
def test_a_stage_is_thin(name: str) -> None:
    """Whole files count; what a stage does stands in the packages that it calls."""
    assert len((ROOT / f"stages/{name}.py").read_text(encoding="utf-8").splitlines()) <= 40


def test_no_file_is_too_large_to_be_read() -> None:
    assert len((ROOT / "params.yaml").read_bytes()) <= 12 * 1024
    assert len((ROOT / "dvc.lock").read_bytes()) <= 60 * 1024


def test_params_yaml_equals_the_composed_configuration() -> None:
    text = (ROOT / "params.yaml").read_text(encoding="utf-8")
    assert text == compose_params(), "run `python -m stages.params` and commit params.yaml"


def test_plans_equal_the_composed_configuration() -> None:
    plans = {path.stem: path.read_text(encoding="utf-8") for path in (ROOT / "plans").iterdir()}
    assert plans == plans_of(compose_conf()), "run `python -m stages.params` and commit plans/"


def test_params_and_plans_together_are_the_configuration() -> None:
    conf, found = compose_conf(), OmegaConf.load(ROOT / "params.yaml")
    plans = {path.stem: OmegaConf.load(path) for path in (ROOT / "plans").iterdir()}
    both = OmegaConf.to_container(OmegaConf.merge(found, plans), resolve=True)
    whole = OmegaConf.to_container(OmegaConf.create(conf), resolve=True)
    assert both == {name: section for name, section in whole.items() if name not in compose.BY_HAND}  # type: ignore[union-attr]


def test_sections_that_no_pipeline_runs_are_no_parameters() -> None:
    used = {key.partition(".")[0] for p, name in STAGES for key in stages(p)[name].get("params", [])}
    found = set(OmegaConf.load(ROOT / "params.yaml"))
    assert found - used == {"executor", "variants"}  # how many processes, and what each stage is run on


def test_params_knows_an_edit_by_hand_from_an_old_file() -> None:
    old = compose_params(["chunk.steps=9"])
    assert is_as_written(old)
    assert not is_as_written(old.replace("steps: 9", "steps: 8"))
    found = differences({"a": {"b": 1, "c": 2}}, {"a": {"b": 3, "c": 2}})
    assert found == ["a.b: 1 in params.yaml, 3 in conf/"]


@pytest.mark.parametrize("pipeline", [*PIPELINES, "figures/dvc.yaml"])
def test_the_lock_holds_no_stage_that_is_gone(pipeline: str) -> None:
    """DVC reads and writes the whole lock after every stage, which takes it a second for 7000 lines."""
    path = (ROOT / pipeline).with_suffix(".lock")
    if path.exists():
        names = {name.rpartition(":")[2] for name in stage_names(Path(pipeline))}
        assert set(yaml.safe_load(path.read_text(encoding="utf-8"))["stages"]) <= names


def test_figures_that_take_hours_are_frozen() -> None:
    assert all(stage["frozen"] for stage in stages("figures/dvc.yaml").values())


def test_models_that_land_are_of_the_steps_that_land() -> None:
    """The pipeline trains the steps of the runs that the released learned MPC lands with."""
    conf = compose_conf()
    for name, folder in conf["land"]["models"].items():
        own = OmegaConf.to_container(OmegaConf.create(conf), resolve=True)["variants"]["chunk"][Path(folder).name]  # type: ignore[index,call-overload]
        grid = conf["land"]["grids"][name]
        assert {"flight_step_s": own["flight_step_s"], "contact_step_s": conf["chunk"]["contact_step_s"]}.items() <= (
            grid.items()
        )
        assert grid["steps"] == conf["chunk"]["steps"]


def test_every_size_composes() -> None:
    for path in (ROOT / "conf" / "size").glob("*.yaml"):
        assert compose_params([f"size={path.stem}"])
