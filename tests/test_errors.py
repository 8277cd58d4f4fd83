"""Messages that a user is meant to read."""

import sys

import pytest

from leapgap.errors import InputError, needs
from leapgap.runtime.executor import Executor


def test_a_missing_package_names_the_extra_that_brings_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "rerun", None)
    with pytest.raises(InputError) as caught, needs("view"):
        import rerun  # noqa: F401
    assert str(caught.value) == (
        "import of rerun: found no package of that name; expected what the extra 'view' installs; "
        "pip install 'leapgap[view]'"
    )


def test_a_missing_module_of_our_own_is_no_missing_extra() -> None:
    with pytest.raises(ModuleNotFoundError), needs("view"):
        import leapgap.no_such_module  # noqa: F401


def test_cases_in_processes_name_the_extra_they_need(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "joblib", None)
    with pytest.raises(InputError, match=r"pip install 'leapgap\[pipeline\]'"):
        list(Executor("joblib", 2).map(abs, [-1]))
