"""The diagnosis of a folder of logs against a robot.

Examples:

    python -m stages.diagnose diagnose.logs=jumps diagnose.robot=model.xml diagnose.out=report
"""

from dataclasses import replace
from functools import partial
from pathlib import Path

from omegaconf import DictConfig

from leapgap.diagnosis.settings import Settings
from leapgap.errors import InputError
from leapgap.reports.diagnosis import PAGE, PageSettings, diagnose_folder
from leapgap.reports.kept import keep, write_note
from leapgap.runtime.atomic_io import write_json
from leapgap.runtime.output_folder import whole_folder
from stages.common import output_folder, read_config, run_stage
from stages.robot import load_robot

STAGE = "stages.diagnose"
SWEPT = ("gap_corrected", "gap_nominal", "closure_heldout", "noise_floor")
"""Figures for the table of a sweep, the one that is ranked by first."""


def diagnose(config: DictConfig) -> dict[str, float] | None:
    """Judge the logs, then write report, corrected robot, replays and recording, all or nothing.

    The figures that a sweep tabulates are returned; None without logs.
    """
    section = config.diagnose
    settings = read_config(Settings, section.settings, "diagnose.settings")
    page = read_config(PageSettings, config.report, "report")
    if section.threads is not None and (not isinstance(section.threads, int) or section.threads < 1):
        raise InputError("diagnose.threads", str(section.threads), "null or a number of 1 or more", "correct it")
    model = section.robot or config.robot.model
    out = output_folder(section.out, STAGE, (section.logs, model))
    replays = output_folder(section.replays, STAGE, (section.logs, model, out)) if section.replays else None
    robot, logs = load_robot(config, section.robot), Path(section.logs)
    others = [load_robot(config, model) for model in section.robots]
    report = diagnose_folder(logs, robot, settings, partial(print, flush=True), section.threads, descriptions=others)
    if report is None:
        print(f"no logs in {logs}: nothing to diagnose")
    if section.pages:
        from leapgap.reports.pages import write_pages  # imports Rerun, which a refusal does without

        write_pages(report, out, STAGE, replace(page, recordings=section.recordings), replays)
    else:
        with whole_folder(out, STAGE) as folder:
            write_note(folder) if report is None else keep(report, folder)
    if report is None:
        return None
    if section.metrics:
        write_json(Path(section.metrics), report.content.metrics())
    print(report.sentence)
    if section.pages:
        print(f"report: {out / PAGE}")
    figures = report.content.metrics()
    return {name: figures[name] for name in SWEPT if isinstance(figures[name], float)}


if __name__ == "__main__":
    run_stage(diagnose)
