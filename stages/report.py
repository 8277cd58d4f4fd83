"""The page, the recording and the replays of a diagnosis that stage `diagnose` or `diagnose_withheld` kept as data.

Examples:

    python -m stages.report report.diagnosis=data/diagnoses/damped report.out=report
"""

from pathlib import Path

from omegaconf import DictConfig

from leapgap.reports.diagnosis import PAGE, PageSettings
from leapgap.reports.kept import kept, write_pages
from stages.common import output_folder, read_config, run_stage

STAGE = "stages.report"


def report(config: DictConfig) -> None:
    """Write what a person looks at of a diagnosis."""
    page = read_config(PageSettings, config.report, "report")
    out = output_folder(page.out, STAGE, (page.diagnosis,))
    replays = output_folder(page.replays, STAGE, (page.diagnosis, out)) if page.replays else None
    diagnosis = Path(page.diagnosis)
    write_pages(kept(diagnosis), out, STAGE, page, replays, diagnosis)
    print(f"report: {out / PAGE}")


if __name__ == "__main__":
    run_stage(report)
