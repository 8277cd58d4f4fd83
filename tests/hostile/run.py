"""The long hostile checks by hand: ``python -m tests.hostile.run``, or ``make hostile``.

Each part returns figures by name; they are written into ``metrics/hostile.json`` as soon as the part is done, so that a
part can also be run alone. A figure of a part that never ran is null. A further part is a function in ``PARTS``.
"""

import argparse
import json
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path

from leapgap.atomic_io import write_json
from tests.code import ROOT
from tests.hostile import logs as hostile_logs
from tests.hostile.kills import kill_everything
from tests.hostile.ticks import a1_and_reference, bad_problems, hostile_ticks

FIGURES = (
    *("inputs", "refused", "set_aside", "accepted_harmless", "accepted_nonsense", "traceback", "hang", "memory"),
    *("ticks", "nonfinite", "outside_limits", "exceptions"),
    *("kills", "partial_visible", "orphans", "bytes_differ"),
)
SEED = 1


def ticks(chosen: argparse.Namespace) -> Mapping[str, int]:
    """Controllers of every kind, told nonsense; and bad problems for the solvers, of which none may raise."""
    tally = hostile_ticks(chosen.ticks, SEED, *a1_and_reference())
    raised = {says: n for says, n in bad_problems(1000, SEED).items() if "raised" in says}
    print(tally.first or "no finding", raised or "")
    names = ("ticks", "nonfinite", "outside_limits", "exceptions")
    figures = {name: getattr(tally, name) for name in names}
    return figures | {"exceptions": tally.exceptions + tally.unrecovered + sum(raised.values())}


def kills(chosen: argparse.Namespace) -> Mapping[str, int]:
    """Stages with workers, killed in turn and run again."""
    with tempfile.TemporaryDirectory() as folder:
        return vars(kill_everything(chosen.kills, Path(folder), lambda line: print(line, flush=True)))


def logs(chosen: argparse.Namespace) -> Mapping[str, int]:
    """Corrupted logs for every reader, each classified."""
    return hostile_logs.all_cases(SEED)


PARTS: Mapping[str, Callable[[argparse.Namespace], Mapping[str, int]]] = {"ticks": ticks, "kills": kills, "logs": logs}


def main() -> None:
    """Run the chosen parts and write their figures."""
    parser = argparse.ArgumentParser(prog="python -m tests.hostile.run", description="The long hostile checks.")
    parser.add_argument("--parts", default=",".join(PARTS), help=f"some of {', '.join(PARTS)}; default: all")
    parser.add_argument("--ticks", type=int, default=1_000_000, help="number of hostile ticks (1000000)")
    parser.add_argument("--kills", type=int, default=100, help="number of kills (100)")
    parser.add_argument("--json", type=Path, default=ROOT / "metrics" / "hostile.json", help="file of the figures")
    chosen = parser.parse_args()
    unknown = set(chosen.parts.split(",")) - set(PARTS)
    if unknown:
        parser.error(f"unknown parts {', '.join(sorted(unknown))}; known are {', '.join(PARTS)}")
    for name in chosen.parts.split(","):
        known = json.loads(chosen.json.read_text(encoding="utf-8")) if chosen.json.is_file() else {}
        figures = {**known, **PARTS[name](chosen)}
        write_json(chosen.json, {figure: figures.get(figure) for figure in FIGURES})
    print(f"figures: {chosen.json}")


if __name__ == "__main__":
    main()
