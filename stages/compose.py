"""Composes conf/ to params.yaml, the snapshot that DVC reads, and to the plans of tests beside it.

Plans (which tasks are run, which effects are drawn) are data files below plans/ that stages depend on; they are no
parameters. Sections of commands that are no stage of a pipeline are left out.
"""

import hashlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml
from hydra import compose, initialize_config_dir
from hydra.errors import HydraException
from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException

from leapgap.errors import InputError
from leapgap.runtime.atomic_io import write_text
from stages.common import PARAMS, config_error
from stages.help import CONF

WIDTH = 120
HEADER = """\
# Composed from conf/ by the stage `params`. Not to be edited: change conf/ and run `dvc repro`.
# Digest of what follows: {digest}
"""


PLANNED = {
    "collect": ("variants",),
    "land": ("grids", "method_settings", "practice", "tasks"),
    "optimize": ("targets",),
    "withhold": ("chosen", "clocks", "further", "halves", "owners", "robots", "shares", "signed", "sizes", "too_high"),
}
"""Keys of sections that are plans."""
BY_HAND = ("bench", "export", "robots")  # sections of commands that no pipeline runs


def compose_conf(overrides: Sequence[str] = ()) -> dict[str, Any]:
    """Compose ``conf/``; what it refers to stays a reference."""
    try:
        with initialize_config_dir(version_base="1.3", config_dir=str(CONF)):
            found = OmegaConf.to_container(compose("config", list(overrides)))
    except (HydraException, OmegaConfBaseException) as error:
        raise config_error(error) from None
    assert isinstance(found, dict)
    return {str(name): section for name, section in found.items()}


def compose_params(overrides: Sequence[str] = ()) -> str:
    """The parameters of all stages as one YAML text with a header."""
    conf = compose_conf(overrides)
    sections = {name: section for name, section in conf.items() if name not in BY_HAND}
    sections["variants"] = OmegaConf.to_container(OmegaConf.create(conf), resolve=True)["variants"]
    for name, keys in PLANNED.items():
        sections[name] = {key: value for key, value in sections[name].items() if key not in keys}
    return with_header(sections)


def plans_of(conf: Mapping[Any, Any]) -> dict[str, str]:
    """The plans of each section as YAML text with a header, by the section's name."""
    return {name: with_header({key: conf[name][key] for key in keys}) for name, keys in PLANNED.items()}


def with_header(content: Mapping[str, Any]) -> str:
    """A YAML text, innermost lists and mappings on one line each."""
    body = yaml.safe_dump(dict(content), sort_keys=False, default_flow_style=None, width=WIDTH, allow_unicode=True)
    return HEADER.format(digest=digest(body)) + body


def digest(body: str) -> str:
    """Digest of the text below the header; it distinguishes an edited file from an outdated one."""
    return hashlib.sha256(body.encode()).hexdigest()[:16]


def is_as_written(text: str) -> bool:
    """Whether the text of a params.yaml is unchanged since this stage wrote it."""
    lines = text.splitlines(keepends=True)
    head = HEADER.count("\n")
    return "".join(lines[:head]) == HEADER.format(digest=digest("".join(lines[head:])))


def differences(old: Any, new: Any, file: Path = PARAMS, key: str = "") -> list[str]:
    """Keys that differ between a file and conf/, each with both values."""
    if isinstance(old, dict) and isinstance(new, dict):
        keys = [*old, *(name for name in new if name not in old)]
        return [
            line
            for name in keys
            for line in differences(old.get(name), new.get(name), file, f"{key}.{name}" if key else name)
        ]
    return [] if old == new else [f"{key}: {old} in {file}, {new} in conf/"]


def changes(old: str, new: str, file: Path) -> str:
    """Differences between two texts of a composed file as one line."""
    try:
        before, after = (OmegaConf.to_container(OmegaConf.create(text)) for text in (old, new))
    except (yaml.YAMLError, OmegaConfBaseException):
        return "no valid YAML"
    return "; ".join(differences(before, after, file)) or "comments or order"


def write_composed(path: Path, text: str) -> None:
    """Write a composed file; ``InputError`` for one that was edited by hand."""
    old = path.read_text(encoding="utf-8") if path.is_file() else text
    if old != text and not is_as_written(old):
        raise InputError(
            path,
            f"settings changed here ({changes(old, text, path)})",
            "settings changed in conf/ only",
            f"move them into conf/, then delete {path} and run again",
        )
    write_text(path, text)
