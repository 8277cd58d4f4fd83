"""One truth about every setting: dataclasses carry the defaults, and conf/ shows the same ones.

A field without a default is conf's alone; a field that conf does not show is the dataclass's alone. A library call with
a settings object as it is made is then the instrument that the pipeline runs.
"""

import ast
import importlib
from collections.abc import Iterator, Mapping
from dataclasses import MISSING, fields, is_dataclass
from functools import cache
from typing import Any

import pytest
from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf

from leapgap.diagnosis.settings import Settings
from leapgap.jumping.learning.models.residual_networks import NetworksConfig
from leapgap.jumping.learning.store import settings_by_section
from leapgap.logs.importers import formats
from stages.common import CONF, read_config
from stages.sections.train import read_train_config
from tests.code import ROOT

DATA = {
    "land.tasks.*": "each entry is a task of its own, and no entry is the default one",
    "robots.cases.*": "each entry is a case of its own, and no entry is the default one",
    "withhold.chosen.*": "each entry is a case of its own, and no entry is the default one",
}
"""Entries of conf that are data: an instance of a dataclass, where others are instances too."""

READERS = ("read_config", "read_each", "read_optional")
"""How a stage reads one dataclass. What ``read_one_of`` reads are instances: data."""


@cache
def conf(*overrides: str) -> Mapping[str, Any]:
    """The whole configuration as composed."""
    with initialize_config_dir(version_base="1.3", config_dir=str(CONF)):
        found = OmegaConf.to_container(compose("config", list(overrides)), resolve=True)
    assert isinstance(found, dict)
    return found  # type: ignore[return-value]


def read_by_stages() -> list[tuple[str, type]]:
    """Key and dataclass of every section that a stage reads; a part of a key that is known at run time is ``*``."""
    found: set[tuple[str, type]] = set()
    for path in sorted((ROOT / "stages").rglob("*.py")):
        if path.stem == "common":
            continue  # it defines the readers
        module = importlib.import_module(".".join(path.relative_to(ROOT).with_suffix("").parts))
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in READERS:
                kind, _, key = node.args
                wanted = pattern(key) + (".*" if node.func.id == "read_each" else "")
                if wanted not in DATA and section(wanted.partition(".*")[0]) is not None:
                    found |= {(name, own) for name in keys(wanted) for own in kinds(kind, name, module)}
    return sorted(found, key=lambda one: one[0])


def pattern(key: ast.expr) -> str:
    """The key of a call, its computed parts as ``*``."""
    if isinstance(key, ast.JoinedStr):
        return "".join(str(part.value) if isinstance(part, ast.Constant) else "*" for part in key.values)
    assert isinstance(key, ast.Constant)
    return str(key.value)


def keys(wanted: str) -> list[str]:
    """The keys of conf that a pattern stands for."""
    head, star, _ = wanted.partition(".*")
    return [f"{head}.{name}" for name in section(head)] if star else [wanted]


def section(key: str) -> Any:
    """A part of the configuration."""
    found: Any = conf()
    for name in key.split("."):
        found = found[name]
    return found


def kinds(expression: ast.expr, key: str, module: Any) -> list[type]:
    """The dataclass that a call names; others are found by the name of the section, as the stages do."""
    if isinstance(expression, ast.Name):
        return [getattr(module, expression.id)]
    part, _, name = key.rpartition(".")
    by_name: dict[str, Mapping[str, type]] = {
        "import_logs": {name: kind.Options for name, kind in formats().items()},
        "train": settings_by_section(),
    }
    return [by_name[part][name]] if name in by_name[part] else []


def differences(kind: type, shown: Mapping[str, Any], key: str) -> Iterator[str]:
    """Fields of a dataclass whose default is another than what conf shows."""
    for field in fields(kind):
        default = field.default if field.default_factory is MISSING else field.default_factory()
        if default is not MISSING and field.name in shown:
            yield from apart(default, shown[field.name], f"{key}.{field.name}")


def apart(default: Any, shown: Any, key: str) -> Iterator[str]:
    """The same of a value, field by field where it is a dataclass."""
    if is_dataclass(default) and isinstance(shown, Mapping):
        for field in fields(default):
            if field.name in shown:
                yield from apart(getattr(default, field.name), shown[field.name], f"{key}.{field.name}")
    elif plain(default) != plain(shown):
        yield f"{key}: {default!r} in the dataclass, {shown!r} in conf/"


def plain(value: Any) -> Any:
    """Sequences of any kind as lists."""
    if isinstance(value, Mapping):
        return {key: plain(item) for key, item in value.items()}
    return [plain(item) for item in value] if isinstance(value, list | tuple) else value


@pytest.mark.parametrize(("key", "kind"), read_by_stages())
def test_defaults_are_what_conf_shows(key: str, kind: type) -> None:
    assert list(differences(kind, section(key), key)) == []


def test_every_section_with_a_dataclass_is_found() -> None:
    """The walk above sees what stages read: nested, computed and imported under another name alike."""
    found = {key for key, _ in read_by_stages()}
    assert found >= {"collect", "train", "evaluate", "diagnose.settings", "withhold.halves.tuning", "optimize"}
    assert found >= {"land", "import_logs.csv", "import_logs.published", "collect.sensing", "executor", "view"}
    assert found >= {"train.kernel", "train.networks", "train.published_recipe"}


def test_the_walk_sees_nested_differences() -> None:
    shown = {"joint": {"steps": 3, "most_causes": 8}, "noise_draws": 4, "nothing": 1}
    found = list(differences(Settings, shown, "diagnose"))
    assert [line.split(":")[0] for line in found] == ["diagnose.joint.steps", "diagnose.noise_draws"]


def test_a_library_call_with_settings_as_made_is_the_stage() -> None:
    read = read_config(Settings, OmegaConf.create(section("diagnose.settings")), "diagnose.settings")
    assert read == Settings()
    assert Settings().tolerances, "a diagnosis without tolerances takes small errors of any model for causes"


def test_a_mapping_in_conf_stands_in_place_of_the_default_and_is_not_laid_over_it() -> None:
    """What a section leaves out of a mapping is left out: inputs of networks, tolerances."""
    chosen = OmegaConf.create(conf("train/inputs=no_phase")["train"])
    assert "phase" not in read_train_config(chosen).settings(NetworksConfig).inputs
    none = OmegaConf.create({"tolerances": {}})
    assert read_config(Settings, none, "diagnose.settings").tolerances == {}
