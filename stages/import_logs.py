"""Import logs of other formats as jump logs.

Examples:

    python -m stages.import_logs import_logs.source=raw import_logs.format=published import_logs.out=jumps
"""

from pathlib import Path
from typing import Any

from omegaconf import DictConfig

from leapgap.errors import InputError
from leapgap.jumping import published_a1  # noqa: F401 (found by its entry point; named so that DVC knows its code)
from leapgap.logs import log as jump_log
from leapgap.logs.importers import log_format
from leapgap.output_folder import whole_folder
from leapgap.robot.model import Robot
from stages.common import output_folder, read_config, run_stage

STAGE = "stages.import_logs"


def import_logs(config: DictConfig) -> None:
    """Import every jump of ``import_logs.source``; one that cannot be used stops the stage and writes nothing."""
    settings = config.import_logs
    source = Path(settings.source)
    if not source.is_dir():
        raise InputError("import_logs.source", str(source), "a folder", "name the folder of the logs")
    out = output_folder(settings.out, STAGE, (source, config.robot.model))
    layout = log_format(settings.format)
    options: Any = read_config(layout.Options, settings[settings.format], f"import_logs.{settings.format}")
    robot = Robot.load(config.robot.model)
    paths = layout.find(source)
    with whole_folder(out, STAGE) as folder:
        for name, path in paths.items():
            jump_log.write_log(layout.read(path, name, robot, options), folder / f"{name}.parquet")
    print(f"{len(paths)} jumps imported" if paths else f"no logs in {source}: no real jumps, which is no error")


if __name__ == "__main__":
    run_stage(import_logs)
