"""A proposal as the text that is printed: YAML that an import takes, with what is known of it as comments."""

import re
from dataclasses import dataclass
from pathlib import Path
from shlex import quote
from typing import Any

import yaml

from leapgap.errors import CONTROL, InputError, printable
from leapgap.logs.files import check_file, check_folder, check_tree, decoding
from leapgap.logs.importers import formats, log_format
from leapgap.logs.importers.csv import opened
from leapgap.logs.importers.table_format import TableFormat
from leapgap.logs.map_proposal.evidence import ABSENT, GUESSED, MISSING, SURE, UNUSED, Draft
from leapgap.logs.map_proposal.table_map import propose
from leapgap.robot.model import Robot

HEADINGS = (
    (SURE, "Sure:"),
    (GUESSED, "Guessed, check it:"),
    (MISSING, "Missing, nothing is assumed:"),
    (ABSENT, "Not in the logs, or left out:"),
    (UNUSED, "Columns that the map does not use:"),
)
PARTS = (
    *("skip_rows", "delimiter", "decimal_point", "header"),
    *("joint_names", "columns", "units", "factors", "offsets", "constants", "gains"),
    *("period_s", "steps", "repeated_times", "cut_by"),
)
MOST_COLUMNS = 10_000  # columns from which a map is proposed
DELIMITERS, COMMENTS = (";", "\t", " "), ("#", "%")
DECIMAL_COMMA = re.compile(r"\d,\d")
MOST_FILES = 5  # files that a question names
LONGEST_LINE = 1_000_000  # bytes of the first lines that are looked at


@dataclass(frozen=True)
class ProposedMap:
    """A proposal for the logs of one format, and the file that it was made from."""

    proposal: Draft
    format: str
    path: Path

    @property
    def options(self) -> dict[str, Any]:
        """The options of an import, in the order in which they are printed."""
        return {part: self.proposal.options[part] for part in PARTS if part in self.proposal.options}

    @property
    def guesses(self) -> list[str]:
        """What an import goes on without knowing."""
        return [*self.proposal.notes_of(GUESSED), *self.proposal.notes_of(ABSENT)]

    def text(self, robot: Robot) -> str:
        """The proposal as YAML with comments; what is missing is never filled in."""
        lines = [
            f"# Map proposed for {printable(self.path.name)}, robot {printable(robot.name)}. Nothing is imported.",
            "# Check it, save it, then",
            "#   leapgap import <logs> <robot> --options <this file> --out <folder>",
        ]
        for kind, heading in HEADINGS:
            sentences = self.proposal.notes_of(kind)
            if sentences:
                lines += [f"# {heading}", *(f"#   {printable(sentence)}" for sentence in sentences)]
        held = {"format": self.format, self.format: self.options}
        text = yaml.safe_dump(held, sort_keys=False, allow_unicode=True, width=110)
        if CONTROL.search(text.replace("\n", "")):
            text = yaml.safe_dump(held, sort_keys=False, width=110)
        return "\n".join([*lines, "", text])

    def answered(self, source: Path, robot: Path) -> dict[str, Any]:
        """The options, where nothing is missing; ``InputError`` names the questions and the command that asks them."""
        missing = self.proposal.notes_of(MISSING)
        if missing:
            asked = f"leapgap import --guess {quote(str(source))} {quote(str(robot))} > map.yaml"
            do = f"{asked}; answer there, then import with --options map.yaml"
            raise InputError(self.path, "questions that the logs do not answer", "a whole map", do, missing)
        return self.options


def propose_map(source: Path, robot: Robot, format: str | None = None) -> ProposedMap:
    """The proposal for the first log below a folder, or for a file; nothing is imported."""
    layout, path = first_file(source, format)
    check_tree(path, f"a log of format {layout.name}", "copy the files themselves")
    with decoding(path, layout.name, "export it again"):
        written = as_written(layout, path)
        options = layout.Options(**written)
        first = layout.first_log(layout.table(path, options))
        stated = layout.stated(path, options)
    if len(first.columns) > MOST_COLUMNS:
        raise InputError(path, f"{len(first.columns)} columns", f"at most {MOST_COLUMNS}", "write the map by hand")
    proposal = propose(first, robot, stated)
    if written.get("header") is False:
        proposal.say(MISSING, f"names of the columns: {path.name} has no header; its columns are called 0, 1, 2, …")
    if layout.name == "csv" and source.is_dir() and proposal.notes_of(MISSING):
        head = first_lines(path)[1][0]
        others = [one.name for one in layout.find(source).values() if first_lines(one)[1][0] != head]
        if others:
            beside = ", ".join(sorted(others)[:MOST_FILES])
            proposal.say(MISSING, f"other columns in {beside}: if they are of the same run, join them on one clock")
    proposal.options |= written
    return ProposedMap(proposal, layout.name, path)


def as_written(layout: TableFormat, path: Path) -> dict[str, Any]:
    """How a text table is written, as options: lines before it, its delimiter, a decimal comma, and no header."""
    if layout.name != "csv":
        return {}
    before, (first, second) = first_lines(path)
    delimiter = delimiter_of(first, second)
    found: dict[str, Any] = {"skip_rows": before} if before else {}
    found |= {"delimiter": delimiter} if delimiter != "," else {}
    found |= {"decimal_point": ","} if delimiter != "," and DECIMAL_COMMA.search(second) else {}
    return found | ({"header": False} if is_of_numbers(first, delimiter) else {})


def first_lines(path: Path) -> tuple[int, list[str]]:
    """How many lines of comments a text begins with, and the two lines after them.

    A line of names that begins like a comment, as NumPy writes it, has numbers below it, as many as names.
    """
    check_file(path, "a text table", "copy the file itself")
    with opened(path) as file:
        text = file.read(LONGEST_LINE).decode("utf-8-sig", errors="replace")
    lines = [line.strip() for line in text.split("\n")]
    before = 0
    while lines[before].startswith(COMMENTS) and before + 1 < len(lines):
        one = delimiter_of(lines[before + 1], lines[before + 1])
        if is_of_numbers(lines[before + 1], one) and lines[before].lstrip("#% ").count(one) == lines[before + 1].count(
            one
        ):
            break
        before += 1
    return before, [*lines[before : before + 2], ""][:2]


def delimiter_of(line: str, numbers: str) -> str:
    """What separates the cells of a line; a comma, unless there is none or the ``numbers`` below have decimal ones."""
    found = [one for one in DELIMITERS if one in line and ("," not in line or is_of_numbers(numbers, one))]
    return found[0] if found else ","


def is_of_numbers(line: str, delimiter: str) -> bool:
    """Whether all cells of a line are numbers."""
    return all(is_number(cell if delimiter == "," else cell.replace(",", ".")) for cell in line.split(delimiter))


def is_number(text: str) -> bool:
    """Whether a text is a number."""
    try:
        float(text)
    except ValueError:
        return False
    return True


def first_file(source: Path, format: str | None) -> tuple[TableFormat, Path]:
    """The format of a source, and its first file; the formats are tried if none is stated.

    Layouts of folders come before formats of files, and JSON last: settings are often written in it.
    """
    if not source.exists():
        raise InputError(source, "no such file or folder", "logs", "name the folder of the logs, or one of them")
    if source.is_dir():
        check_folder(source)
    found = []
    for name in [format] if format else formats():
        layout = log_format(name)
        if not isinstance(layout, TableFormat):
            continue
        paths = list(layout.find(source).values())
        if paths and (format or source.is_dir() or source.name.endswith(layout.suffixes)):
            found.append((paths[0].is_file(), name == "json", layout, paths[0]))
    if found:
        _, _, layout, path = min(found, key=lambda one: one[:2])
        return layout, path
    endings = {end for kind in formats().values() if issubclass(kind, TableFormat) for end in kind.suffixes}
    below = next((one for one in sorted(source.glob("*/*")) if one.name.endswith(tuple(endings))), None)
    if below is not None:
        do = f"name {below.parent}; where a run is several files, join them into one on one clock, or use SAGE's layout"
        raise InputError(source, f"files in folders, such as {below.name}", "logs side by side", do)
    known = ", ".join(name for name, kind in formats().items() if issubclass(kind, TableFormat))
    raise InputError(source, "no file of a known format", f"one of {known}", "state --format, or export the logs")
