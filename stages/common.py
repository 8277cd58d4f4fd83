"""The one entry point of every stage.

From ``dvc.yaml`` (DVC sets ``DVC_STAGE``) a stage reads ``params.yaml``; by hand it is a Hydra application that
composes ``conf/``. Both take the same ``key=value`` arguments, so a stage's ``cmd`` reads like a call by hand.
Bad input ends with exit code 2 and one message, and no traceback. Hydra is imported where it is used: what DVC starts
does without it, and so do workers.
"""

import hashlib
import os
import re
import shutil
import sys
from argparse import ArgumentParser
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from functools import cache
from pathlib import Path
from typing import Any, NoReturn, TypeVar

import yaml
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from leapgap.errors import InputError, did_you_mean, printable
from leapgap.runtime.atomic_io import read_json, write_json
from leapgap.runtime.import_closure import PACKAGE, SourceTree
from leapgap.runtime.output_folder import AS_IT_WAS, STATES, check_output, folder_lock, package_version, system_error
from leapgap.runtime.typed_values import from_mapping
from stages.code import check_loaded
from stages.help import CONF

ROOT = Path(__file__).resolve().parent.parent
PARAMS = Path("params.yaml")
PLANS = Path("plans")
"""Folder of plans of tests: parts of sections that are data files and not parameters, composed from conf/ too."""
JOBS, FIGURES, FAILED = "jobs", "figures", "failed"
"""Folder of a multirun's results, and what a result holds: the figures of the job, or why it failed."""

LONGEST_MESSAGE = 300  # characters of a message of another library that are repeated
UNKNOWN_KEY = re.compile(r"(?:Could not override '|not in struct full_key: )([\w.]+)")
NO_OPTION = re.compile(r"Could not find '([\w/]+)/(.+?)' Available options in '[^']*': (.*?)(?: Config search|$)")
"""How Hydra and OmegaConf say that a key, or an option of a group, is not known."""

T = TypeVar("T")


def run_stage(stage: Callable[[DictConfig], Any], extensible: str | None = None) -> None:
    """Run a stage's function with its configuration; every stage module calls this as its ``__main__``.

    The function may return figures by name, which a sweep tabulates (``stages.sweep``). ``extensible`` is a section
    whose sections take keys that conf/ does not show; the stage refuses those that are wrong.
    """
    name = Path(sys.argv[0]).stem

    def stage_or_refusal(config: DictConfig) -> Any:
        config.robot.model = find_model(config.robot.model)
        if in_sweep():
            return run_job(name, stage, config)
        try:
            return stage(config)
        except (InputError, OSError) as error:
            refuse(name, error)
        finally:
            OUTPUTS.close()

    try:
        if "DVC_STAGE" in os.environ:
            stage_or_refusal(params_with_overrides(sys.argv[1:], extensible))
            check_loaded(name, sys.modules)
        else:
            check_options(sys.argv[1:])
            sys.argv[1:] = [with_leave_to_add(argument, extensible) for argument in sys.argv[1:]]
            run_with_hydra(stage_or_refusal, name)
    except (InputError, OSError) as error:
        refuse(name, error)


def run_command(name: str, command: Callable[[list[str]], int | None]) -> None:
    """Run a command that takes words and no settings, with these words, and end with the exit code that it returns."""
    try:
        sys.exit(command(sys.argv[1:]))
    except (InputError, OSError) as error:
        refuse(name, error)


def program(name: str) -> str:
    """The path of a program that a command calls, DVC or git; ``InputError`` where there is none."""
    found = shutil.which(name)
    if found is None:
        do = "activate the project's environment: . .venv/bin/activate"
        raise InputError(name, "no such program", "a program on the path", do)
    return found


def run_job(name: str, stage: Callable[[DictConfig], Any], config: DictConfig) -> Any:
    """Run one job of a multirun and keep its result below the folder of the multirun; its figures, by name.

    A job whose settings have a result of the same code there already is not run again. One that fails is kept with its
    message, and the others go on; the next multirun into the folder tries it again. A sweeper that optimises gets the
    first figure.
    """
    from hydra.core.hydra_config import HydraConfig

    hydra_config = HydraConfig.get()
    settings = OmegaConf.to_yaml(config, resolve=True, sort_keys=True)
    key = hashlib.sha256(f"{name} {package_version()}\n{settings}".encode()).hexdigest()[:16]
    path = Path(hydra_config.sweep.dir) / JOBS / f"{key}.json"
    found = dict(read_json(path)) if path.is_file() else {}
    if FIGURES in found and found.get("code") == code_of(name):
        print(f"kept: {hydra_config.job.override_dirname or 'defaults'}")
    else:
        if FIGURES in found:
            print(f"again, since the code has changed: {hydra_config.job.override_dirname or 'defaults'}")
        found = {"overrides": list(hydra_config.overrides.task), "folder": str(hydra_config.runtime.output_dir)}
        found["code"] = code_of(name)
        try:
            returned = stage(config)
            found[FIGURES] = returned if isinstance(returned, dict) else {}
        except Exception as error:
            message = str(error) if isinstance(error, InputError) else printable(f"{type(error).__name__}: {error}")
            print(f"failed: {message}", file=sys.stderr)
            found[FAILED] = message
        finally:
            OUTPUTS.close()
        write_json(path, found)
    if "_target_" in hydra_config.sweeper and "optuna" in hydra_config.sweeper._target_.lower():
        return next((value for value in found.get(FIGURES, {}).values() if isinstance(value, float)), float("inf"))
    return found.get(FIGURES)


@cache
def code_of(name: str) -> str:
    """Hash of all code that a stage imports."""
    return SourceTree((PACKAGE, Path(__file__).parent)).code_hash(f"stages.{name}")


def find_model(model: str) -> str:
    """A model file from any working folder: a path in ``conf/`` is relative to the project."""
    return str(ROOT / model) if not Path(model).exists() and (ROOT / model).is_file() else model


def refuse(name: str, error: InputError | OSError) -> NoReturn:
    """Print the message of bad input and exit with code 2; Hydra adds nothing to a ``SystemExit``."""
    if isinstance(error, BrokenPipeError):  # nobody reads what is printed; Python must not flush into it at exit
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    message = error if isinstance(error, InputError) else system_error(error)
    print(f"stages.{name}: {message}", file=sys.stderr)
    raise SystemExit(2) from None


def run_with_hydra(stage: Callable[[DictConfig], Any], name: str) -> None:
    """Compose ``conf/`` with the command line (``key=value``, ``-m`` for sweeps) and run the stage."""
    import hydra
    from hydra.errors import HydraException

    os.environ["HYDRA_FULL_ERROR"] = "1"  # hand errors to us instead of exit code 1
    sys.argv.append(f"hydra.job.name={name}")  # names the run folder
    application = hydra.main(version_base="1.3", config_path=str(CONF), config_name="config")(stage)
    try:
        with unchecked_help():
            application()
    except (HydraException, OmegaConfBaseException, yaml.YAMLError) as error:
        raise config_error(error) from None


@contextmanager
def unchecked_help() -> Iterator[None]:
    """Let Hydra 1.3 make its parser: Python 3.14 looks at help texts at once, and one of Hydra's is not a text yet."""
    parser: Any = ArgumentParser
    check = getattr(parser, "_check_help", None)
    if check is None:
        yield
        return
    parser._check_help = lambda *_: None
    try:
        yield
    finally:
        parser._check_help = check


def with_leave_to_add(argument: str, extensible: str | None) -> str:
    """An override of a key in a section of the extensible section as Hydra takes it where conf/ has no such key."""
    key, is_override, _ = argument.partition("=")
    parts = key.split(".")
    return f"++{argument}" if is_override and len(parts) > 2 and parts[0] == extensible else argument


def params_with_overrides(arguments: list[str], extensible: str | None = None) -> DictConfig:
    """``params.yaml`` of the working folder with its plans, overridden by ``key=value`` arguments.

    ``extensible`` as in ``run_stage``.
    """
    try:
        params = OmegaConf.merge(
            read_params(), *({path.stem: OmegaConf.load(path)} for path in sorted(PLANS.glob("*")))
        )
        OmegaConf.set_struct(params, True)
        if extensible is not None:
            OmegaConf.set_struct(params[extensible], False)
        return OmegaConf.merge(params, OmegaConf.from_dotlist(arguments))
    except OmegaConfBaseException as error:
        raise config_error(error) from None


def read_params() -> DictConfig:
    """``params.yaml`` of the working folder; ``InputError`` for one that is broken."""
    do = "write it again: python -m stages.params"
    if not PARAMS.is_file():
        raise InputError(PARAMS, "no such file", "the parameters of all stages", do)
    try:
        params = OmegaConf.load(PARAMS)
    except (yaml.YAMLError, UnicodeDecodeError, RecursionError) as error:
        says = " ".join(str(error).split())[:LONGEST_MESSAGE]
        raise InputError(PARAMS, f"no valid YAML ({says})", "the parameters of all stages", do) from None
    if not isinstance(params, DictConfig) or not params:
        raise InputError(PARAMS, "no sections", "the parameters of all stages", do)
    return params


def config_error(error: Exception) -> InputError:
    """An error of Hydra or OmegaConf as an ``InputError`` of one line, in words of this project."""
    message = " ".join(str(error).split()).partition(" See https:")[0].removesuffix(".")
    do = "look the key up in conf/, or run with --cfg job to see them all"
    if unset := re.search(r"Error parsing override '(.*)' missing EQUAL", message):
        return InputError("configuration", f"{unset[1]}, which sets nothing", "key=value", "write it so, or see --help")
    if group := NO_OPTION.search(message):
        options = group[3].split()
        nearest = did_you_mean(group[2], options) or "choose one"
        return InputError("configuration", f"no {group[1]}={group[2]}", f"one of {', '.join(options)}", nearest)
    if unknown := UNKNOWN_KEY.search(message):
        found = f"the unknown key {unknown[1]}"
        return InputError("configuration", found, "a key of conf/", nearest_key(unknown[1]) or do)
    return InputError("configuration", message, "keys, groups and types of conf/", do)


def nearest_key(key: str) -> str | None:
    """``did you mean …?`` for a key that conf/ does not have; None where none is near."""
    files = [*CONF.glob("*/default.yaml"), CONF / "robot" / "a1.yaml"]
    known = keys_below({path.parent.name: OmegaConf.to_container(OmegaConf.load(path)) for path in files})
    return did_you_mean(key, [*known, "size"])


def check_options(arguments: Sequence[str]) -> None:
    """Raise ``InputError`` for an option that Hydra does not have; it would print a page of usage."""
    from hydra._internal.utils import get_args_parser

    with unchecked_help():
        known = [option for option in get_args_parser()._option_string_actions if option.startswith("--")]
    for argument in arguments:
        option = argument.partition("=")[0]
        if option.startswith("--") and not any(one.startswith(option) for one in known):
            expected = "key=value, --help, --version or an option of Hydra"
            do = did_you_mean(option, [*known, "--version"]) or "see --help and --hydra-help"
            raise InputError("command line", option, expected, do)


def keys_below(value: Any, above: str = "") -> list[str]:
    """Full keys of a configuration, those of sections too."""
    if not isinstance(value, dict):
        return []
    full = {f"{above}{key}": one for key, one in value.items()}
    return [*full, *(deeper for key, one in full.items() for deeper in keys_below(one, f"{key}."))]


def read_config(kind: type[T], section: DictConfig, key: str) -> T:
    """Turn a section of the configuration into the dataclass that documents it.

    A key the dataclass lacks, or a value of the wrong type, is an ``InputError`` with the full key.
    """
    try:
        return from_mapping(kind, OmegaConf.to_container(section, resolve=True), key, ".")
    except OmegaConfBaseException as error:
        raise config_error(error) from None
    except ValueError as error:  # a dataclass that refuses its values
        raise InputError(key, str(error), "values that fit together", "correct them in conf/") from None


def read_optional(kind: type[T], section: DictConfig | None, key: str) -> T | None:
    """Like ``read_config`` for a section that may be absent or null, which gives ``None``."""
    return None if section is None else read_config(kind, section, key)


def read_each(kind: type[T], section: DictConfig, key: str) -> dict[str, T]:
    """Like ``read_config`` for each entry of a section, by its name."""
    return {str(name): read_config(kind, section[name], f"{key}.{name}") for name in section}


def read_one_of(kinds: Mapping[str, type[T]], section: Mapping[str, Any], key: str) -> dict[str, T]:
    """Read each entry as the dataclass that its ``kind`` names; an unknown kind is an ``InputError``."""
    entries = {}
    for name, raw in section.items():
        values = dict(raw)
        kind = values.pop("kind", None)
        if kind not in kinds:
            raise InputError(f"{key}.{name}.kind", str(kind), f"one of {', '.join(kinds)}", "choose a known kind")
        entries[name] = read_config(kinds[kind], OmegaConf.create(values), f"{key}.{name}")
    return entries


def run_folder() -> Path:
    """Hydra's folder of this job."""
    from hydra.core.hydra_config import HydraConfig

    return Path(HydraConfig.get().runtime.output_dir)


def in_sweep() -> bool:
    """Whether this is a job of a Hydra multirun."""
    if "hydra.core.hydra_config" not in sys.modules:
        return False
    from hydra.core.hydra_config import HydraConfig
    from hydra.types import RunMode

    return HydraConfig.initialized() and HydraConfig.get().mode == RunMode.MULTIRUN


OUTPUTS = ExitStack()  # locks of the output folders of the running stage


def output_folder(
    out: Any, by: str, inputs: Iterable[str | Path | None] = (), kept: bool = False, name: str = "out"
) -> Path:
    """The configured output folder, checked and locked until the stage ends; see ``leapgap.runtime.output_folder``.

    By default, outside DVC, it is the folder ``name`` in Hydra's run folder of this job. ``by`` is the stage, and
    ``inputs`` are the files and folders that it reads; ``kept``: the stage adds to the folder instead of replacing it.
    """
    if out is None and "DVC_STAGE" in os.environ:
        raise InputError("configuration", "no output folder", "<stage>.out=<folder> in dvc.yaml's cmd", "add it")
    folder = run_folder() / name if out is None else Path(out)
    STATES[check_output(folder, by, inputs, kept)] = AS_IT_WAS
    OUTPUTS.enter_context(folder_lock(folder))
    return folder
