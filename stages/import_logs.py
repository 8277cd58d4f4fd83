"""Import logs of other formats as logs of ours.

Examples:

    python -m stages.import_logs import_logs.source=raw import_logs.format=published import_logs.out=jumps
"""

from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf

from leapgap.errors import InputError
from leapgap.jumping import published_a1  # noqa: F401 (found by its entry point; named so that DVC knows its code)
from leapgap.logs import log as log_file
from leapgap.logs.importers import log_format
from leapgap.output_folder import whole_folder
from stages.common import output_folder, read_config, run_stage
from stages.robot import load_robot

STAGE = "stages.import_logs"


def import_logs(config: DictConfig) -> None:
    """Import every log of ``import_logs.source``; one that cannot be used stops the stage and writes nothing."""
    settings = config.import_logs
    source = Path(settings.source)
    if not source.exists():
        raise InputError("import_logs.source", str(source), "a folder", "name the folder of the logs")
    out = output_folder(settings.out, STAGE, (source, config.robot.model))
    layout = log_format(settings.format)
    options: Any = read_config(layout.Options, section(settings), f"import_logs.{settings.format}")
    robot = load_robot(config)
    paths = layout.find(source)
    number = 0
    with whole_folder(out, STAGE) as folder:
        for name, path in paths.items():
            for log in layout.read_all(path, name, robot, options):
                log_file.write_log(log, folder / f"{log.name}.parquet")
                number += 1
    print(f"{number} logs imported" if paths else f"no logs in {source}: none of a real robot, which is no error")


def section(settings: DictConfig) -> DictConfig:
    """The options of the chosen format; none where the source's file in conf/ has no section for it."""
    found = settings.get(settings.format)
    return OmegaConf.create({}) if found is None else found


if __name__ == "__main__":
    run_stage(import_logs)
