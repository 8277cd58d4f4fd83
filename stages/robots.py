"""Logs of real robots with published answers: imported, diagnosed, and held against them.

Examples:

    python -m stages.robots robots.raw=data/raw
"""

import tempfile
import time
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf

from leapgap.diagnosis.settings import Settings
from leapgap.errors import InputError
from leapgap.logs.importers import log_format
from leapgap.logs.importers.base import LogFormat
from leapgap.reports.diagnosis import CORRECTED, REPORT, diagnose_logs
from leapgap.runtime.atomic_io import read_json, write_json
from leapgap.runtime.cache import ResultCache, result_key
from leapgap.runtime.output_folder import claim_folder
from leapgap.simulation.corrected import MODEL
from leapgap.validation.real_robots import RealCase, is_here, outcome_of, published_pushes, read_case
from stages.common import CONF, output_folder, read_config, run_stage

STAGE = "stages.robots"
ROW = ".json"
"""Ending of the file with the row of a case, beside the folder of its report."""


@dataclass(frozen=True)
class RobotsSettings:
    """Section ``robots`` of the configuration."""

    raw: str
    out: str | None
    metrics: str | None
    cases: dict[str, Any]
    """Name of a case → its ``RealCase``, read one by one so that a wrong key is told with its case."""
    pushes: dict[str, dict[str, str]]
    """Name of a case → joint → column of its tables with the torque that pushed it, hidden from the diagnosis."""


def robots(config: DictConfig) -> None:
    """Diagnose every case whose files are there, write its report, and a table of all; finished cases are kept."""
    chosen = read_config(RobotsSettings, config.robots, "robots")
    settings, raw = read_config(Settings, config.diagnose.settings, "diagnose.settings"), Path(chosen.raw)
    out = output_folder(chosen.out, STAGE, (raw,), kept=True)
    cases = cases_here(config, chosen, raw)
    if not cases:  # reports of an earlier run stay
        print(f"nothing was diagnosed, and {out} was left as it is")
        return
    cache = ResultCache(claim_folder(out, STAGE))
    for name in cases:
        cache.expect(name)
    cache.sweep()
    table = {
        name: judge(cache, name, case, raw, importer(case.import_logs), settings, chosen.pushes.get(name, {}))
        for name, case in cases.items()
    }
    if chosen.metrics:
        write_json(Path(chosen.metrics), {"cases": table})


def judge(
    cache: ResultCache,
    name: str,
    case: RealCase,
    raw: Path,
    source: tuple[LogFormat, Any],
    settings: Settings,
    pushes: Mapping[str, str],
) -> Mapping[str, Any]:
    """The row of one case, from the cache where it is there. Its report lies at the case's place in the cache.

    ``source``: format and options of its import; ``pushes``: joint → column of the torque that pushed it.
    """
    with tempfile.TemporaryDirectory() as models:
        corrected = corrected_by(case, cache.folder, name)
        robot, logs = read_case(case, raw, *source, Path(models), corrected)
        published = published_pushes(raw / case.source, pushes)
        key = result_key(diagnose_logs, [case, robot, logs, settings, published])
        if cache.get(name, key) is None:
            begin = time.perf_counter()
            report = diagnose_logs(logs, robot, settings, progress=partial(print, flush=True))
            outcome = outcome_of(case, report.content, time.perf_counter() - begin, published)
            with cache.store(name, key) as folder:
                report.save(folder / name)
                write_json(folder / f"{name}{ROW}", outcome)
    row = read_json(cache.folder / f"{name}{ROW}")
    verdict = "right" if row["right"] else "FALSE NAME" if row["false_name"] else "missed"
    sentence = read_json(cache.folder / name / REPORT)["sentence"]
    print(f"{name}: {'not judged' if case.expected is None else verdict}. {sentence}", flush=True)
    return row


def cases_here(config: DictConfig, chosen: RobotsSettings, raw: Path) -> dict[str, RealCase]:
    """The cases whose files are there, by name; the others are said."""
    found = {}
    for name in chosen.cases:
        case = read_config(RealCase, config.robots.cases[name], f"robots.cases.{name}")
        if is_here(case, raw):
            found[name] = case
            continue
        absent = case.robot if (raw / case.source).exists() else case.source
        source = Path(case.source).parts[0]
        print(f"{name}: no files in {raw / absent}, left out; python -m stages.fetch {source} brings them")
    return found


def corrected_by(case: RealCase, folder: Path, name: str) -> Path | None:
    """The model file that an earlier case of the table has corrected, where a case is judged against that."""
    if case.after is None:
        return None
    path = folder / case.after / CORRECTED / MODEL
    if not path.is_file():
        expected = "the name of an earlier case with a corrected model"
        raise InputError(
            f"robots.cases.{name}.after", case.after, expected, "correct the name, or put that case before"
        )
    return path


def importer(name: str) -> tuple[LogFormat, Any]:
    """Format and options of an import, by the name of its file in conf/import_logs."""
    settings: Any = OmegaConf.load(CONF / "import_logs" / f"{name}.yaml")
    layout = log_format(settings.format)
    return layout, read_config(layout.Options, settings[settings.format], f"import_logs.{settings.format}")


if __name__ == "__main__":
    run_stage(robots)
