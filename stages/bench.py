"""Tuning cases of every family diagnosed and scored: one table that every change of the diagnosis is judged by.

Cases are drawn once and kept. A verdict is kept until the logs, the code of the diagnosis or its settings change, so
that a run that was killed goes on where it was.

Examples:

    python -m stages.bench
    python -m stages.bench 'bench.families=[a1]' 'bench.only=[case_000,case_001]' bench.metrics=null
"""

from omegaconf import DictConfig, OmegaConf

from leapgap.runtime.atomic_io import read_json
from leapgap.runtime.cache import ResultCache
from leapgap.runtime.executor import Executor
from leapgap.runtime.output_folder import claim_folder
from stages.bench_cases import ROBOTS, BenchSettings, run_families, write_table
from stages.common import output_folder, read_config, run_stage
from stages.robot import load_robot
from stages.robots import robots
from stages.sections.diagnosis import diagnosis_settings


def bench(config: DictConfig) -> None:
    """Draw the cases that are missing, diagnose those without a valid verdict, and write the table."""
    chosen = read_config(BenchSettings, config.bench, "bench")
    executor, own = read_config(Executor, config.executor, "executor"), diagnosis_settings(config, chosen.settings)
    out = output_folder(chosen.out, "stages.bench", (chosen.raw, config.robot.model), kept=True)
    run_families(chosen, own, load_robot(config), ResultCache(claim_folder(out, "stages.bench")), executor)
    if ROBOTS in chosen.families:
        found = out / f"{ROBOTS}.json"
        section = {"raw": chosen.raw, "out": str(out / ROBOTS), "metrics": str(found)}
        robots(OmegaConf.merge(config, {"robots": section}))
        write_table(chosen, {ROBOTS: read_json(found)} if found.is_file() else {})


if __name__ == "__main__":
    run_stage(bench)
