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
from leapgap.logs.reading import read_foreign
from leapgap.runtime.output_folder import whole_folder
from stages.common import output_folder, read_config, run_stage
from stages.robot import load_robot

STAGE = "stages.import_logs"


def import_logs(config: DictConfig) -> None:
    """Import every log of ``import_logs.source``; those that cannot be used are set aside and listed.

    Where fewer than two others are left, nothing is written.
    """
    settings = config.import_logs
    source = Path(settings.source)
    if not source.exists():
        raise InputError("import_logs.source", str(source), "a folder", "name the folder of the logs")
    out = output_folder(settings.out, STAGE, (source, config.robot.model))
    layout = log_format(settings.format)
    options: Any = read_config(layout.Options, section(settings), f"import_logs.{settings.format}")
    robot = load_robot(config)
    readings = read_foreign(layout, source, robot, options)
    with whole_folder(out, STAGE) as folder:
        for log in readings.logs:
            log_file.write_log(log, folder / f"{log.name}.parquet")
    for line in readings.lines():
        print(line)
    number = len(readings.logs)
    print(f"{number} logs imported" if number else f"no logs in {source}: none to import, which is no error")


def section(settings: DictConfig) -> DictConfig:
    """The options of the chosen format; none where the source's file in conf/ has no section for it."""
    found = settings.get(settings.format)
    return OmegaConf.create({}) if found is None else found


if __name__ == "__main__":
    run_stage(import_logs)
