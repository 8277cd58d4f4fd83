"""Import logs of other formats into the format of leapgap.

Examples:

    python -m stages.import_logs import_logs.source=raw import_logs.format=published import_logs.out=jumps
"""

from pathlib import Path

from omegaconf import DictConfig, OmegaConf

from leapgap.errors import InputError
from leapgap.jumping import published_a1  # noqa: F401 (found by its entry point; named so that DVC knows its code)
from leapgap.logs.importers import log_format
from leapgap.logs.log import write_logs
from leapgap.logs.reading import read_foreign
from leapgap.runtime.output_folder import whole_folder
from stages.common import output_folder, read_config, run_stage
from stages.robot import load_robot

STAGE, NONE = "stages.import_logs", OmegaConf.create({})


def import_logs(config: DictConfig) -> None:
    """Import every log of ``import_logs.source``; of those that cannot be used it is said why."""
    settings, source = config.import_logs, Path(config.import_logs.source)
    if not source.exists():
        raise InputError("import_logs.source", str(source), "a folder", "name the folder of the logs")
    out = output_folder(settings.out, STAGE, (source, config.robot.model))
    layout, section = log_format(settings.format), settings.get(settings.format) or NONE
    options: object = read_config(layout.Options, section, f"import_logs.{settings.format}")
    read = read_foreign(layout, source, load_robot(config), options)
    with whole_folder(out, STAGE) as folder:
        write_logs(read.logs, folder)
    said = f"{len(read.logs)} logs imported" if read.logs else f"no logs in {source}: none to import, which is no error"
    print(*read.lines(), said, sep="\n")


if __name__ == "__main__":
    run_stage(import_logs)
