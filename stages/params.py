"""Compose conf/ to params.yaml, the snapshot that DVC reads.

``conf/`` is the only place to change a setting. ``dvc repro`` does not compose by itself, so this first stage does;
``dvc exp run -S`` writes ``params.yaml`` itself, so this stage then leaves it alone.

Examples:

    python -m stages.params
"""

import hashlib
import os
import sys
from typing import Any

from hydra import compose, initialize_config_dir
from hydra.errors import HydraException
from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException
from yaml import YAMLError

from leapgap.atomic_io import write_text
from leapgap.errors import InputError
from stages.common import PARAMS, config_error, refuse
from stages.help import CONF, answered_at_once

HEADER = """\
# Composed from conf/ by the stage `params`. Not to be edited: change conf/ and run `dvc repro`.
# Digest of what follows: {digest}
"""


def compose_params(overrides: list[str] | None = None) -> str:
    """Compose ``conf/`` to one YAML text with a header."""
    try:
        with initialize_config_dir(version_base="1.3", config_dir=str(CONF)):
            body = OmegaConf.to_yaml(compose("config", overrides or []), sort_keys=False)
    except (HydraException, OmegaConfBaseException) as error:
        raise config_error(error) from None
    return HEADER.format(digest=digest(body)) + body


def digest(body: str) -> str:
    """Digest of the text below the header; it distinguishes an edited file from an outdated one."""
    return hashlib.sha256(body.encode()).hexdigest()[:16]


def is_as_written(text: str) -> bool:
    """Whether the text of a params.yaml is unchanged since this stage wrote it."""
    lines = text.splitlines(keepends=True)
    head = HEADER.count("\n")
    return "".join(lines[:head]) == HEADER.format(digest=digest("".join(lines[head:])))


def differences(old: Any, new: Any, key: str = "") -> list[str]:
    """Keys that differ between two configurations, each with both values."""
    if isinstance(old, dict) and isinstance(new, dict):
        keys = [*old, *(name for name in new if name not in old)]
        return [
            line
            for name in keys
            for line in differences(old.get(name), new.get(name), f"{key}.{name}" if key else name)
        ]
    return [] if old == new else [f"{key}: {old} in params.yaml, {new} in conf/"]


def changes(old: str, new: str) -> str:
    """Differences between two texts of params.yaml as one line."""
    try:
        before, after = (OmegaConf.to_container(OmegaConf.create(text)) for text in (old, new))
    except (YAMLError, OmegaConfBaseException):
        return "no valid YAML"
    return "; ".join(differences(before, after)) or "comments or order"


def params() -> None:
    """Write ``params.yaml``; keep that of an experiment, and refuse one that was edited by hand."""
    text = compose_params()
    if "DVC_EXP_NAME" in os.environ:
        print("params.yaml is the experiment's own: kept")
        return
    old = PARAMS.read_text(encoding="utf-8") if PARAMS.is_file() else text
    if old != text and not is_as_written(old):
        raise InputError(
            PARAMS,
            f"settings changed here ({changes(old, text)})",
            "settings changed in conf/ only",
            "move them into conf/, then delete params.yaml and run again",
        )
    write_text(PARAMS, text)


if __name__ == "__main__":
    try:
        answer = answered_at_once("params", sys.argv[1:])
        if answer:
            print(answer, end="")
        else:
            params()
    except (InputError, OSError) as error:
        refuse("params", error)
