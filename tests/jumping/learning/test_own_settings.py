"""A model with settings of its own is one file: found, configured by its section, trained, and in the cache's key."""

import importlib.util
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from omegaconf import OmegaConf

from leapgap.errors import InputError
from leapgap.jumping.learning import model_grid, store
from leapgap.jumping.learning import windows as windows_module
from leapgap.jumping.learning.experiment import Split, TrainConfig
from leapgap.jumping.learning.models.kernel import KernelConfig
from leapgap.jumping.learning.models.residual_networks import NetworksConfig
from leapgap.jumping.learning.windows import Windows
from leapgap.runtime.atomic_io import read_json
from leapgap.runtime.cache import ResultCache
from stages.common import with_leave_to_add
from stages.compose import compose_conf
from stages.sections.train import read_train_config
from tests.commands import python
from tests.jumping.learning.test_training import config

FILE = '''
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from leapgap.jumping.learning.model import Model
from leapgap.jumping.learning.recipe import ModelRecipe, ModelSettings


@dataclass
class SlowingSettings(ModelSettings):
    section: ClassVar[str] = "slowing"
    time_constant_s: float = 0.5
    """Time in which velocities fall to 37 %."""
    axes: dict[str, float] = field(default_factory=lambda: {"x": 1.0, "z": 1.0})


@dataclass(frozen=True)
class Slowing(Model):
    kind: ClassVar[str] = "slowing"
    time_constant_s: float

    def predict(self, inputs):
        return np.repeat(inputs.state[:, None], inputs.force.shape[1] + 1, axis=1)

    def settings(self):
        return {"time_constant_s": self.time_constant_s}

    @classmethod
    def from_parts(cls, arrays, settings):
        return cls(settings["time_constant_s"])


class SlowingRecipe(ModelRecipe):
    name = "slowing"
    model = Slowing
    settings = SlowingSettings
    can_be_exported = False

    def fit(self, task):
        return Slowing(task.settings(SlowingSettings).time_constant_s), []


class SlowingTwiceRecipe(ModelRecipe):
    """Reads the model above, so that its settings are its own, too."""

    name = "slowing_twice"
    model = Slowing
    members = ("slowing",)
    can_be_exported = False

    def fit(self, task):
        return Slowing(2 * task.member("slowing").time_constant_s), []
'''


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with the file of the new model, and no other file that knows of it."""
    (tmp_path / "further").mkdir()
    (tmp_path / "further" / "slowing.py").write_text(FILE, encoding="utf-8")
    return tmp_path / "further"


@pytest.fixture
def found(folder: Path, monkeypatch: pytest.MonkeyPatch):
    """The registry of this process with the recipes of that file, as if another package offered them."""
    spec = importlib.util.spec_from_file_location("slowing", folder / "slowing.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, "slowing", module)
    spec.loader.exec_module(module)
    for recipe in (module.SlowingRecipe(), module.SlowingTwiceRecipe()):
        monkeypatch.setitem(store.recipes(), recipe.name, recipe)
    return store.recipes()


TRAIN = """
import runpy, sys
from leapgap.jumping.learning import models
models.__path__.append(sys.argv.pop(1))
runpy.run_module("stages.train", run_name="__main__", alter_sys=True)
"""


def train(folder: Path, windows: Windows, out: Path, *overrides: str, dvc: bool = False) -> subprocess.CompletedProcess:
    """The stage as its users call it, or as DVC does."""
    windows_module.write(windows, out / "windows")
    arguments = [
        "train.models=[slowing,slowing_twice]",
        "train.sessions=null",
        "train.folds=2",
        "train.processes=1",
        f"train.windows={out / 'windows'}",
        f"train.out={out / 'models'}",
        *overrides,
    ]
    return python("-c", TRAIN, folder, *arguments, **({"DVC_STAGE": "train"} if dvc else {}))


@pytest.mark.long
@pytest.mark.parametrize("dvc", [False, True])
def test_its_settings_are_typed_as_those_of_every_model(folder, windows: Windows, tmp_path: Path, dvc: bool) -> None:
    done = train(folder, windows, tmp_path, "train.slowing.time_constant_s=0.25", dvc=dvc)
    assert done.returncode == 0, done.stderr
    stored = {name: read_json(tmp_path / "models" / "all" / f"{name}.json") for name in ("slowing", "slowing_twice")}
    assert stored["slowing"]["settings"] == {"time_constant_s": 0.25}
    assert stored["slowing_twice"]["settings"] == {"time_constant_s": 0.5}
    again = train(folder, windows, tmp_path, "train.slowing.time_constant_s=0.25", dvc=dvc)
    assert "0 models fitted" in again.stdout
    changed = train(folder, windows, tmp_path, dvc=dvc)
    assert "6 models fitted" in changed.stdout, "the default is 0.5 s, for the model and for what reads it"
    assert read_json(tmp_path / "models" / "all" / "slowing.json")["settings"] == {"time_constant_s": 0.5}


@pytest.mark.long
@pytest.mark.parametrize("dvc", [False, True])
@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("train.slowing.time_constant=1", "train.slowing: found the keys time_constant; expected"),
        (
            "train.slowing.time_constant_s=fast",
            "train.slowing.time_constant_s: found 'fast'; expected",
        ),
        ("train.slwing.time_constant_s=1", "train.slwing: found no such key; expected one of curvature, folds, kernel"),
        ("train.kernel.ridge=1", "train.kernel: found the keys ridge; expected keys among"),
    ],
)
def test_a_wrong_setting_is_named(
    folder, windows: Windows, tmp_path: Path, override: str, message: str, dvc: bool
) -> None:
    done = train(folder, windows, tmp_path, override, dvc=dvc)
    assert done.returncode == 2
    assert done.stderr.startswith(f"stages.train: {message}") and len(done.stderr.strip().splitlines()) == 1
    assert not (tmp_path / "models").exists()


@pytest.mark.parametrize(
    ("argument", "passed"),
    [
        ("train.slowing.time_constant_s=1", "++train.slowing.time_constant_s=1"),
        ("train.slowing.time_constant_s=0.1,0.2", "++train.slowing.time_constant_s=0.1,0.2"),
        ("train.models=[a.b.c]", "train.models=[a.b.c]"),
        ("train/inputs=no_phase", "train/inputs=no_phase"),
        ("+train.slowing.time_constant_s=1", "+train.slowing.time_constant_s=1"),
        ("~train.kernel.inputs", "~train.kernel.inputs"),
        ("train.networks.inputs", "train.networks.inputs"),  # as in --package train.networks.inputs
        ("collect.sensing.seed=1", "collect.sensing.seed=1"),
    ],
)
def test_only_overrides_inside_a_section_of_the_stage_may_add_keys(argument: str, passed: str) -> None:
    """The rest of conf/ stays closed, so that a typo is refused by Hydra."""
    assert with_leave_to_add(argument, "train") == passed
    assert with_leave_to_add(argument, None) == argument


def section(**changes: object):
    """The section ``train`` of conf/ with changes."""
    return OmegaConf.merge(OmegaConf.create(compose_conf()), {"train": changes}).train


def test_a_section_replaces_mappings_and_keeps_the_other_defaults(found) -> None:
    (kind,) = (recipe.settings for name, recipe in found.items() if name == "slowing")
    read = read_train_config(section(slowing={"axes": {"z": 2.0}}))
    assert read.settings(kind) == kind(time_constant_s=0.5, axes={"z": 2.0})
    assert read_train_config(section()).settings(kind) == kind()
    assert read.settings(KernelConfig) == KernelConfig() and read.settings(NetworksConfig) == NetworksConfig()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"slowing": 3}, r"train.slowing: found 3; expected a mapping with some of the keys time_constant_s, axes"),
        ({"slowing": None}, r"train.slowing: found None; expected a mapping"),
        ({"model_settings": {"slowing": {}}}, r"train.model_settings: found no such key"),
        ({"kernel": {"inputs": {"z": "high"}}}, r"train.kernel.inputs.z: found 'high'; expected a value of type float"),
    ],
)
def test_a_section_of_another_form_is_named(found, changes: dict, message: str) -> None:
    with pytest.raises(InputError, match=message):
        read_train_config(section(**changes))


@pytest.mark.parametrize(
    ("taken", "message"),
    [
        ("kernel", r"KernelConfig: found the section kernel; expected a section of its own|SlowingSettings: found the"),
        ("seed", r"slowing.SlowingSettings: found the section seed; expected a name that is no key of train"),
    ],
)
def test_a_section_has_one_owner(folder: Path, found, taken: str, message: str, monkeypatch) -> None:
    monkeypatch.setattr(found["slowing"].settings, "section", taken)
    with pytest.raises(InputError, match=message):
        read_train_config(section())


def test_a_key_holds_the_settings_of_the_model_and_of_its_members_and_no_others(found, windows: Windows) -> None:
    base, split = config(models=["slowing", "slowing_twice", "kernel"]), Split("all", windows.jumps, ())
    slowing, kernel = found["slowing"].settings, KernelConfig
    departures = {
        "slowing": {"slowing": slowing(time_constant_s=0.1)},
        "kernel": {"kernel": replace(base.settings(kernel), ridge_flight=0.5)},
        "networks": {"networks": NetworksConfig(seeds=7)},
    }

    def keys(changed: TrainConfig) -> dict[str, str]:
        return model_grid.SplitJob(windows, changed, split, ResultCache(Path())).keys

    before = keys(base)
    changed = {
        name: {
            model
            for model, key in keys(replace(base, model_settings=base.model_settings | more)).items()
            if key != before[model]
        }
        for name, more in departures.items()
    }
    assert changed == {"slowing": {"slowing", "slowing_twice"}, "kernel": {"kernel"}, "networks": set()}
    spelled = replace(base, model_settings=base.model_settings | {"slowing": slowing()})
    assert keys(spelled) == before, "a default that is written out is the default"


def test_blends_depend_on_the_settings_of_both_members(windows: Windows) -> None:
    base, split = config(models=["networks", "kernel", "blend"]), Split("all", windows.jumps, ())
    for kind in (NetworksConfig, KernelConfig):
        one = replace(base.settings(kind), force_scale=1.0)
        changed = replace(base, model_settings=base.model_settings | {kind.section: one})
        before, after = (model_grid.key_of(windows, split, "blend", of) for of in (base, changed))
        assert before != after
    assert sorted(model_grid.own_settings("blend", base)) == ["kernel", "networks"]
