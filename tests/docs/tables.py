"""Tables of Markdown pages, taken apart."""

from pathlib import Path


def table_of(page: Path, title: str) -> list[list[str]]:
    """Cells of the rows of the one table whose heading row begins so, without emphasis and marks of code."""
    text = page.read_text(encoding="utf-8")
    assert text.count(f"\n{title}") == 1, f"{page.name} has {text.count(title)} tables that begin with {title!r}"
    table = text.split(f"\n{title}")[1].split("\n\n")[0]
    return [cells_of(row) for row in table.splitlines()[2:]]


def cells_of(row: str) -> list[str]:
    """Cells of one row, without emphasis and marks of code."""
    return [cell.strip() for cell in row.replace("**", "").replace("`", "").strip("|").split("|")]
