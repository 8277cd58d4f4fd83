"""Logs of real robots with published answers: imported, diagnosed, and held against them.

Examples:

    python -m stages.robots robots.raw=data/raw
"""

from pathlib import Path

from omegaconf import DictConfig

from leapgap.diagnosis.settings import Settings
from leapgap.reports.real_robots import judge_all
from leapgap.runtime.atomic_io import write_metrics
from leapgap.runtime.output_folder import claim_folder
from stages.common import output_folder, read_config, run_stage
from stages.sections.robots import RobotsSettings, cases_here, importer

STAGE = "stages.robots"


def robots(config: DictConfig) -> None:
    """Diagnose every case whose files are there, write its report, and a table of all; finished cases are kept."""
    chosen = read_config(RobotsSettings, config.robots, "robots")
    settings, raw = read_config(Settings, config.diagnose.settings, "diagnose.settings"), Path(chosen.raw)
    out = output_folder(chosen.out, STAGE, (raw,), kept=True)
    cases = cases_here(config, raw)
    if not cases:  # reports of an earlier run stay
        print(f"nothing was diagnosed, and {out} was left as it is")
        return
    table = judge_all(cases, raw, importer, settings, chosen.pushes, claim_folder(out, STAGE))
    if chosen.metrics:
        write_metrics(Path(chosen.metrics), {"cases": table})


if __name__ == "__main__":
    run_stage(robots)
