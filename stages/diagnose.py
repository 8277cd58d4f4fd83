"""The diagnosis of a folder of logs against a robot.

Examples:

    python -m stages.diagnose diagnose.logs=jumps diagnose.robot=model.xml diagnose.out=report
"""

from functools import partial
from pathlib import Path

from omegaconf import DictConfig

from leapgap.reports.diagnosis import PageSettings, diagnose_folder
from leapgap.reports.kept import DiagnoseSettings, write_diagnosis
from stages.common import output_folder, read_config, run_stage
from stages.robot import load_robot

STAGE = "stages.diagnose"


def diagnose(config: DictConfig) -> dict[str, float] | None:
    """Judge the logs, then write report, corrected robot, replays and recording, all or nothing.

    The figures that a sweep tabulates are returned; None without logs.
    """
    chosen = read_config(DiagnoseSettings, config.diagnose, "diagnose")
    page, logs = read_config(PageSettings, config.report, "report"), Path(chosen.logs)
    model = chosen.robot or config.robot.model
    out = output_folder(chosen.out, STAGE, (logs, model))
    replays = output_folder(chosen.replays, STAGE, (logs, model, out)) if chosen.replays else None
    robot, *others = (load_robot(config, one) for one in (chosen.robot, *chosen.robots))
    tell = partial(print, flush=True)
    report = diagnose_folder(logs, robot, chosen.settings, tell, chosen.threads, descriptions=others)
    return write_diagnosis(report, chosen, page, out, replays, STAGE)


if __name__ == "__main__":
    run_stage(diagnose)
