"""The diagnosis of a folder of logs against a robot.

Examples:

    python -m stages.diagnose diagnose.logs=jumps diagnose.robot=model.xml diagnose.out=report
"""

from dataclasses import replace
from functools import partial
from pathlib import Path

from omegaconf import DictConfig

from leapgap.atomic_io import write_json, write_text
from leapgap.diagnosis.settings import Settings
from leapgap.errors import InputError
from leapgap.output_folder import whole_folder
from leapgap.reports.diagnosis import RECORDING, PageSettings, Report, diagnose_folder
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
    from leapgap.reports.diagnosis_recording import record_report  # imports Rerun, which a refusal does without

    with whole_folder(out, STAGE) as folder:
        if report is None:
            write_note(folder)
        else:
            replace(report, record=record_report).write(folder, page.viewer)
            if section.recordings:
                record_report(report, folder / RECORDING)
        if replays is None:
            write_replays_or_note(report, folder / "replays")
    if replays is not None:
        with whole_folder(replays, STAGE) as folder:
            write_replays_or_note(report, folder)
    if report is None:
        return None
    if section.metrics:
        write_json(Path(section.metrics), report.content.metrics())
    print(report.sentence)
    print(f"report: {out / 'report.html'}")
    figures = report.content.metrics()
    return {name: figures[name] for name in SWEPT if isinstance(figures[name], float)}


def write_replays_or_note(report: Report | None, folder: Path) -> None:
    """Write the replays of a report, or that there were no logs."""
    from leapgap.reports.diagnosis_recording import write_replays

    if report is None:
        write_note(folder)
    else:
        write_replays(report, folder)


def write_note(folder: Path) -> None:
    """Write that there were no logs."""
    write_text(folder / "no_logs.txt", "There were no jump logs to diagnose.\n")


if __name__ == "__main__":
    run_stage(diagnose)
