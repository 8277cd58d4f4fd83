"""What people read is in the words of the field, short enough, and says for whom it is."""

import ast
import re
import shlex
from collections.abc import Iterator
from pathlib import Path

import pytest

from leapgap import effects
from leapgap.cli import EXAMPLES, parser
from tests.code import ROOT
from tests.docs.hook import HOOK

RECORD = ("research", "contributing")
PAGES = [
    page for page in sorted((ROOT / "docs").rglob("*.md")) if page.relative_to(ROOT / "docs").parts[0] not in RECORD
]
MADE = {name: HOOK[name]() for name in ("command_page", "effects_page", "settings_page")}
TEXTS = {str(page.relative_to(ROOT)): page.read_text(encoding="utf-8") for page in [ROOT / "README.md", *PAGES]} | MADE
OLD = (
    "logs of ours",
    "not fitted on:",
    "its fellows",
    "a cause without a name",
    "a word for",
    "without a word",
    "stays as it was",
    "by their own clock",
    "where it lies",
    "shrinks from",
    "is told as",
    "are told as",
    "closes 9",
    "closes all",
    "closes the gap",
    "short pieces",
    "whoever ",
    "makes up for",
    "does no good",
    "than believed",
    "mend the",
    "no bit of",
    "from outside:",
    "blind check",
    "anew",
    "told apart",
    "is told",
    "are told",
    "fellows",
    "foretel",
    "foretold",
    "pushed from outside",
    "forces from outside",
    "make up for",
    "own clock",
    "without a word",
    "it closes",
    "which closes",
    "tell them apart",
    "foreign logs",
    "hang together",
    "hardly determine",
    "hardly known",
    "surely",
    "promised closure",
    "realised closure",
)
"""Phrases of our own for which the field has a word."""
RECORDS = [ROOT / name for name in ("CHANGELOG.md", "CONTRIBUTING.md")] + [
    page for page in sorted((ROOT / "docs").rglob("*.md")) if page not in PAGES
]
MOST_WORDS, MOST_README_LINES = 25_000, 100


@pytest.mark.parametrize("page", TEXTS)
def test_no_old_words(page: str) -> None:
    text = " ".join(TEXTS[page].lower().split())
    assert [phrase for phrase in OLD if phrase in text] == []


@pytest.mark.parametrize("page", RECORDS, ids=lambda page: page.stem)
def test_no_old_words_in_the_record_either(page: Path) -> None:
    text = " ".join(page.read_text(encoding="utf-8").lower().split())
    assert [phrase for phrase in OLD if phrase in text] == []


def sentences(path: Path) -> Iterator[str]:
    """Texts of a module that are no docstrings: messages, sentences, words of figures."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    alone = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in alone:
            yield node.value


def test_no_old_words_in_what_the_library_says() -> None:
    source = ROOT / "src" / "leapgap"
    said = {path: sentences(path) for path in source.rglob("*.py") if "jumping" not in path.parts}
    said |= {path: iter([path.read_text(encoding="utf-8")]) for path in source.rglob("*.html")}
    found = [(path.name, phrase) for path, texts in said.items() for text in texts for phrase in OLD if phrase in text]
    assert found == []


def test_examples_of_the_help_are_calls_that_the_commands_take() -> None:
    for name, examples in EXAMPLES.items():
        for example in examples:
            chosen = parser().parse_args(shlex.split(example.partition(" > ")[0])[1:])
            assert chosen.command == name


def test_help_and_descriptions_of_effects_have_no_old_words() -> None:
    said = " ".join([parser().format_help(), *map(effects.describe, effects.known().values())]).lower()
    assert [phrase for phrase in OLD if phrase in said] == []
    assert all(len(effects.describe(kind)) <= 60 for kind in effects.known().values())


def test_messages_of_the_command_name_no_key_of_hydra() -> None:
    """Only the application and the pipeline's own classes know the sections of its configuration."""
    key = re.compile(r"InputError\(\s*f?\"(?:diagnose|import_logs|report|collect|robot)\.\w")
    library = [p for p in (ROOT / "src" / "leapgap").rglob("*.py") if not {"jumping", "validation"} & set(p.parts)]
    assert [str(path) for path in library if key.search(path.read_text(encoding="utf-8"))] == []


@pytest.mark.parametrize("page", [page for page in TEXTS if page != "README.md"])
def test_a_page_says_at_its_top_for_whom_it_is_and_what_one_can_do_after_it(page: str) -> None:
    head, _, rest = TEXTS[page].partition("\n\n")
    assert head.startswith("# ")
    assert re.match(r"\*For \w[^*]*\.\sAfter\sthis\spage\s[^*]*\.", rest), page


def test_the_count_of_effects_is_that_of_the_code() -> None:
    assert f"among {len(effects.known())} effects" in TEXTS["README.md"]
    stated = f"searches {len(effects.known())} effects ({len(effects.by_default())} on a free base, unless named)"
    assert stated in TEXTS["docs/explanation/comparison.md"]


def test_the_front_page_and_the_docs_are_short() -> None:
    assert len(TEXTS["README.md"].splitlines()) <= MOST_README_LINES
    words = sum(bool(re.search(r"\w", word)) for text in TEXTS.values() for word in text.split())
    assert words <= MOST_WORDS, words


def test_links_between_pages_lead_somewhere() -> None:
    """Those of the README as files of the project; the site's own check has the others, with their anchors."""
    links = re.findall(r"\]\(([^)#\s]+)\)?", TEXTS["README.md"])
    made = {"docs/reference/effects.md", "docs/reference/command.md", "docs/reference/settings.md"}
    assert [one for one in links if "://" not in one and one not in made and not (ROOT / one).exists()] == []


def test_the_moving_picture_of_the_front_page_is_small() -> None:
    [picture] = re.findall(r"!\[[^]]*\]\(([^)]+)\)", TEXTS["README.md"])
    assert Path(ROOT / picture).stat().st_size < 2_000_000


def test_the_quoted_error_messages_are_those_of_the_code() -> None:
    table = TEXTS["docs/reference/errors.md"].partition("| message contains")[2]
    quoted = re.findall(r"^\| `([^`]+)`", table, re.MULTILINE)
    code = [path.read_text(encoding="utf-8") for path in (ROOT / "src" / "leapgap").rglob("*.py")]
    assert len(quoted) > 10
    assert [text for text in quoted if not any(text in one for one in code)] == []
