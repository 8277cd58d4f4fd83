"""A proposal as the text that is printed: YAML that an import takes, with what is known of it as comments."""

from pathlib import Path

import yaml

from leapgap.errors import CONTROL, InputError, printable
from leapgap.logs.files import check_folder, check_tree, decoding
from leapgap.logs.importers import formats, log_format
from leapgap.logs.importers.table_format import TableFormat
from leapgap.logs.importers.tables import Table
from leapgap.logs.map_proposal.proposal import GUESSED, MISSING, SURE, UNUSED, Proposal
from leapgap.logs.map_proposal.table_map import propose
from leapgap.robot.model import Robot

HEADINGS = (
    (SURE, "Sure:"),
    (GUESSED, "Guessed, check it:"),
    (MISSING, "Missing, nothing is assumed:"),
    (UNUSED, "Columns that the map does not use:"),
)
PARTS = ("delimiter", "joint_names", "columns", "units", "factors", "constants", "repeated_times", "cut_by")
MOST_COLUMNS = 10_000
"""Columns from which a map is proposed."""
DELIMITERS = (";", "\t", " ")


def propose_map(source: Path, robot: Robot, format: str | None = None) -> str:
    """The proposal for the first log below a folder, or for a file, as YAML; nothing is imported."""
    layout, path = first_file(source, format)
    check_tree(path, f"a log of format {layout.name}", "copy the files themselves")
    with decoding(path, layout.name, "export it anew"):
        table = layout.table(path, layout.Options())
        delimiter = None
        if layout.name == "csv" and len(table.columns) == 1:
            delimiter = next((one for one in DELIMITERS if one in table.columns[0]), None)
            table = layout.table(path, layout.Options(**({"delimiter": delimiter} if delimiter else {})))
        first = layout.first_log(table)
    if len(first.columns) > MOST_COLUMNS:
        raise InputError(path, f"{len(first.columns)} columns", f"at most {MOST_COLUMNS}", "write the map by hand")
    proposal = propose(first, robot)
    if delimiter:
        proposal.options["delimiter"] = delimiter
    return as_text(proposal, table, layout.name, robot)


def first_file(source: Path, format: str | None) -> tuple[TableFormat, Path]:
    """The format of a source, and its first file; the formats are tried if none is stated."""
    if not source.exists():
        raise InputError(source, "no such file or folder", "logs", "name the folder of the logs, or one of them")
    if source.is_dir():
        check_folder(source)
    for name in [format] if format else formats():
        layout = log_format(name)
        if not isinstance(layout, TableFormat):
            continue
        paths = list(layout.find(source).values())
        if paths and (format or source.is_dir() or source.suffix in layout.suffixes):
            return layout, paths[0]
    known = ", ".join(name for name, kind in formats().items() if issubclass(kind, TableFormat))
    raise InputError(source, "no file of a known format", f"one of {known}", "state --format, or export the logs")


def as_text(proposal: Proposal, table: Table, format: str, robot: Robot) -> str:
    """The proposal as YAML with comments; what is missing is never filled in."""
    lines = [
        f"# Map proposed for {printable(table.path.name)}, robot {robot.name}. Nothing is imported.",
        "# Check it, save it, then",
        "#   leapgap import <logs> <robot> --options <this file> --out <folder>",
    ]
    for kind, heading in HEADINGS:
        sentences = proposal.notes_of(kind)
        if sentences:
            lines += [f"# {heading}", *(f"#   {printable(sentence)}" for sentence in sentences)]
    options = {part: proposal.options[part] for part in PARTS if part in proposal.options}
    stated = {"format": format, format: options}
    text = yaml.safe_dump(stated, sort_keys=False, allow_unicode=True, width=110)
    if CONTROL.search(text.replace("\n", "")):
        text = yaml.safe_dump(stated, sort_keys=False, width=110)
    lines += ["", text]
    return "\n".join(lines)
