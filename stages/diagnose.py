"""The diagnosis of a folder of logs against a robot."""

from functools import partial
from pathlib import Path

from omegaconf import DictConfig

from leapgap.atomic_io import whole_folder, write_json, write_text
from leapgap.diagnosis.diagnose import Settings
from leapgap.reports.diagnosis import RECORDING, diagnose_folder
from leapgap.reports.diagnosis_recording import record_report, write_replays
from stages.common import output_folder, read_config, run_stage
from stages.robot import load_robot


def diagnose(config: DictConfig) -> None:
    """Judge the logs, then write report, corrected robot, replays and recording, all or nothing."""
    section = config.diagnose
    settings = read_config(Settings, section.settings, "diagnose.settings")
    robot = load_robot(config, section.robot)
    logs, out = Path(section.logs), output_folder(section.out)
    replays = Path(section.replays) if section.replays else out / "replays"
    report = diagnose_folder(logs, robot, settings, partial(print, flush=True), section.threads)
    if report is None:
        print(f"no logs in {logs}: nothing to diagnose")
        for folder in (out, replays):
            with whole_folder(folder) as empty:
                write_text(empty / "no_logs.txt", "There were no jump logs to diagnose.\n")
        return
    with whole_folder(out) as folder:
        report.write(folder)
        if section.recordings:
            record_report(report, folder / RECORDING)
    with whole_folder(replays) as folder:
        write_replays(report, folder)
    if section.metrics:
        write_json(Path(section.metrics), report.content.metrics())
    print(report.sentence)
    print(f"report: {out / 'report.html'}")


if __name__ == "__main__":
    run_stage(diagnose)
