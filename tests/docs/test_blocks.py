"""The runner of blocks: what it finds, and that a block which fails is seen."""

import os
from pathlib import Path

import pytest

from tests.docs.blocks import BlockError, blocks, run_page, run_shell

PAGE = """# A page

```python
steps = 3
```

Text, and a diagram:

```
data ── stage ── result
```

```bash
echo $((2 + 1)) > steps.txt
```

1. in a list

   ```py
   assert int(open("steps.txt").read()) == steps
   ```

<!-- not run: needs network -->

```
pip install something
```

```json
{"no": "code"}
```
"""


def code_block(language: str, code: str) -> str:
    return f"```{language}\n{code}\n```\n"


def test_blocks_of_a_page_in_order_with_their_lines() -> None:
    found = [(block.line, block.language, block.not_run) for block in blocks("page.md", PAGE)]
    assert found == [(3, "python", None), (13, "shell", None), (19, "python", None), (25, "shell", "needs network")]


def test_blocks_share_names_and_folder_and_the_marked_one_stays_out(tmp_path: Path) -> None:
    ran = run_page("page.md", PAGE, tmp_path, dict(os.environ))
    assert [block.line for block in ran] == [3, 13, 19]
    assert (tmp_path / "steps.txt").read_text() == "3\n"


def test_a_python_block_that_fails_is_named_by_page_and_line(tmp_path: Path) -> None:
    page = "text\n\n" + code_block("python", "a = 1\n\nassert a == 2, 'unequal'")
    with pytest.raises(BlockError, match=r"(?s)page\.md:3: python block failed.*line 6.*unequal"):
        run_page("page.md", page, tmp_path, dict(os.environ))


def test_names_of_one_page_do_not_reach_another(tmp_path: Path) -> None:
    run_page("one.md", code_block("python", "left_over = 1"), tmp_path, dict(os.environ))
    with pytest.raises(BlockError, match="NameError"):
        run_page("two.md", code_block("python", "left_over"), tmp_path, dict(os.environ))


@pytest.mark.parametrize("code", ["false\ntrue", "false | cat", "echo $unset_name_of_a_variable"])
def test_a_shell_block_fails_with_any_of_its_commands(code: str, tmp_path: Path) -> None:
    with pytest.raises(BlockError, match=r"page\.md:1: shell block ended with code \d+"):
        run_page("page.md", code_block("sh", code), tmp_path, dict(os.environ))


@pytest.mark.parametrize(
    ("code", "hangs", "message"),
    [
        ("python -c 'while True: pass'", 60, "page.md:1: shell block takes longer than 1 s on 2 cores"),
        ("sleep 60", 3, "page.md:1: shell block hangs: not done in 3 s"),
    ],
)
def test_a_block_for_which_no_reader_would_wait_fails(code: str, hangs: float, message: str, tmp_path: Path) -> None:
    (block,) = blocks("page.md", code_block("sh", code))
    with pytest.raises(BlockError) as caught:
        run_shell(block, tmp_path, dict(os.environ), seconds=1, hangs=hangs)
    assert str(caught.value) == message


@pytest.mark.parametrize("language", ["", "bash", "sh"])
def test_a_command_without_a_language_runs_too(language: str, tmp_path: Path) -> None:
    with pytest.raises(BlockError, match="no_such_file"):
        run_page("page.md", code_block(language, "python no_such_file.py"), tmp_path, dict(os.environ))


@pytest.mark.parametrize(
    ("page", "message"),
    [
        ("<!-- not run: -->\n" + code_block("sh", "true"), "page.md:1: 'not run' says no reason"),
        ("<!-- not run: why -->\ntext\n" + code_block("sh", "true"), "page.md:1: 'not run' stands before no block"),
        ("<!-- not run: why -->\n", "page.md:1: 'not run' stands before no block"),
        (
            "<!-- not run: why -->\n" + code_block("json", "{}"),
            "page.md:2: marked 'not run', but no block of Python or shell",
        ),
        ("```python\na = 1\n", "page.md:1: fence is not closed"),
    ],
)
def test_a_mark_or_fence_that_hides_blocks_is_refused(page: str, message: str) -> None:
    with pytest.raises(BlockError) as caught:
        list(blocks("page.md", page))
    assert str(caught.value) == message


def test_output_is_compared_word_by_word_and_its_numbers_to_a_tenth(tmp_path: Path) -> None:
    page = code_block("python", "print('gap 0.294, then\\n  all of it, swing_0', end='')") + code_block(
        "output", "gap 0.30,\nthen all"
    )
    run_page("page.md", page, tmp_path, dict(os.environ))
    for said in ("then none", "gap 0.3 m", "gap 0.33,", "gap 0.250,", "gap -0.294,", "swing_2"):
        with pytest.raises(BlockError, match="no block before it has printed"):
            run_page("page.md", page + code_block("output", said), tmp_path, dict(os.environ))


def test_a_stale_number_is_shown_beside_the_printed_one(tmp_path: Path) -> None:
    page = code_block("python", "print('95 %: 0.337 to 0.462')") + code_block("output", "95 %: 0.376 to 0.423")
    with pytest.raises(BlockError, match=r"but with the numbers 95 0\.337 0\.462"):
        run_page("page.md", page, tmp_path, dict(os.environ))
