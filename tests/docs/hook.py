"""The functions that make pages of the site, by name."""

import runpy
from typing import Any

from tests.code import ROOT

HOOK: dict[str, Any] = runpy.run_path(str(ROOT / "docs" / "generated_pages.py"))
