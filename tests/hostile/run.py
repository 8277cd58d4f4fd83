"""The long hostile checks by hand: ``python -m tests.hostile.run``, or ``make hostile``.

Each part returns figures by name; they are written into ``metrics/hostile.json`` after each piece of a part, so that a
part can also be run alone. A run that was ended goes on where it was. A figure of a part that never ran is null. A
further part is a function in ``PARTS``.
"""

import argparse
import hashlib
import json
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from leapgap.runtime.atomic_io import write_json
from tests.code import ROOT
from tests.hostile import logs as hostile_logs
from tests.hostile.kills import AT_ONCE, kills_number
from tests.hostile.ticks import a1_and_reference, bad_problems, hostile_ticks

FIGURES = (
    *("inputs", "refused", "set_aside", "accepted_harmless", "accepted_nonsense"),
    *("traceback", "hang", "memory", "control"),
    *("ticks", "nonfinite", "outside_limits", "exceptions"),
    *("kills", "partial_visible", "orphans", "bytes_differ"),
)
SEED = 1
TICKS_AT_ONCE, PROBLEMS_AT_ONCE = 14_000, 20
"""Of one piece: ten jumps, and bad problems for the solvers."""


def ticks(chosen: argparse.Namespace, progress: "Progress") -> Mapping[str, int]:
    """Controllers of every kind, told nonsense; and bad problems for the solvers, of which none may raise."""
    robot, reference = a1_and_reference()

    def chunk(number: int) -> dict[str, int]:
        tally = hostile_ticks(TICKS_AT_ONCE, (SEED, number), robot, reference)
        raised = {says: n for says, n in bad_problems(PROBLEMS_AT_ONCE, SEED + number).items() if "raised" in says}
        if tally.first or raised:
            print(f"ticks {number}: {tally.first} {raised or ''}", flush=True)
        figures = {name: getattr(tally, name) for name in ("ticks", "nonfinite", "outside_limits", "exceptions")}
        return figures | {"exceptions": tally.exceptions + tally.unrecovered + sum(raised.values())}

    return progress.total("ticks", -(-chosen.ticks // TICKS_AT_ONCE), chunk)


def kills(chosen: argparse.Namespace, progress: "Progress") -> Mapping[str, int]:
    """Stages with workers, killed in turn and run again."""
    pieces = -(-chosen.kills // AT_ONCE)
    return progress.total("kills", pieces, lambda number: vars(kills_number(number, chosen.work / "kills")))


@dataclass
class Progress:
    """Figures of what is done, on disk after each piece, so that a run that ends goes on where it was.

    They hold for the code that they were made with: other code begins anew.
    """

    path: Path
    write: Callable[[Mapping[str, int]], None]
    """Writes the sums so far where they are read."""

    def total(self, part: str, pieces: int, run: Callable[[int], Mapping[str, int]]) -> Mapping[str, int]:
        """Run the pieces of a part that are not done yet; the sums of all of them."""
        done = self._done(part)
        for number in range(pieces):
            if str(number) not in done:
                done[str(number)] = dict(run(number))
                write_json(self.path / f"{part}.json", {"code": code_hash(), "pieces": done})
                self.write(sums(done))
                print(f"{part} {number + 1} of {pieces}: {done[str(number)]}", flush=True)
        return sums(done)

    def _done(self, part: str) -> dict[str, dict[str, int]]:
        path = self.path / f"{part}.json"
        known = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}
        return dict(known["pieces"]) if known.get("code") == code_hash() else {}


def sums(done: Mapping[str, Mapping[str, int]]) -> dict[str, int]:
    """The sum of each figure over all pieces."""
    total = Counter[str]()
    for figures in done.values():
        total.update(figures)
    return dict(total)


@cache
def code_hash() -> str:
    """Hash of the code that is tried, and of what tries it, as it was when this process began."""
    hashed = hashlib.sha256()
    for folder in ("src", "stages", "tests/hostile"):
        for path in sorted((ROOT / folder).rglob("*.py")):
            hashed.update(path.read_bytes())
    return hashed.hexdigest()


def logs(chosen: argparse.Namespace, progress: "Progress") -> Mapping[str, int]:
    """Corrupted logs for every reader, each classified."""
    pieces = -(-len(hostile_logs.cases()) // hostile_logs.CASES_AT_ONCE)
    return progress.total("logs", pieces, lambda number: hostile_logs.cases_number(number, SEED))


Part = Callable[[argparse.Namespace, Progress], Mapping[str, int]]
PARTS: Mapping[str, Part] = {"ticks": ticks, "kills": kills, "logs": logs}


def main() -> None:
    """Run the chosen parts and write their figures."""
    parser = argparse.ArgumentParser(prog="python -m tests.hostile.run", description="The long hostile checks.")
    parser.add_argument("--parts", default=",".join(PARTS), help=f"some of {', '.join(PARTS)}; default: all")
    parser.add_argument("--ticks", type=int, default=1_000_000, help="number of hostile ticks (1000000)")
    parser.add_argument("--kills", type=int, default=100, help="number of kills (100)")
    parser.add_argument("--work", type=Path, default=ROOT / "data" / "hostile", help="folder of what is done so far")
    parser.add_argument("--json", type=Path, default=ROOT / "metrics" / "hostile.json", help="file of the figures")
    chosen = parser.parse_args()
    unknown = set(chosen.parts.split(",")) - set(PARTS)
    if unknown:
        parser.error(f"unknown parts {', '.join(sorted(unknown))}; known are {', '.join(PARTS)}")
    progress = Progress(chosen.work.resolve(), lambda figures: write_figures(chosen.json, figures))
    code_hash()
    for name in chosen.parts.split(","):
        write_figures(chosen.json, PARTS[name](chosen, progress))
    print(f"figures: {chosen.json}")


def write_figures(path: Path, figures: Mapping[str, int]) -> None:
    """Write some figures into the file, beside those that are there."""
    known = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}
    every = {**known, **figures}
    write_json(path, {name: every.get(name) for name in dict.fromkeys((*FIGURES, *known))})


if __name__ == "__main__":
    main()
