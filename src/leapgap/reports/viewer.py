"""The Rerun viewer and a recording inside a page, so that one file shows plots and moving robot without a network.

The viewer is WebAssembly of the package ``rerun-notebook``, of the version of ``rerun-sdk``. Only two of its files are
read; what that package imports for notebooks is not needed.
"""

import re
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from pathlib import Path

from leapgap.errors import InputError
from leapgap.reports.page import pack

SCRIPT, WASM = "widget.js", "re_viewer_bg.wasm"
FETCH = re.compile(r"//!<INLINE-MARKER-OPEN>.*?//!<INLINE-MARKER-CLOSE>", re.DOTALL)
"""The part of the viewer's script that loads the WebAssembly."""
EXPORT = re.compile(r"\nexport\s*\{[^}]*\};?\s*$")
FROM_PAGE = """
  const packed = document.getElementById("viewer-wasm").textContent;
  const bytes = Uint8Array.from(atob(packed), (c) => c.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
  return new Response(stream, {headers: {"Content-Type": "application/wasm"}});
"""


@dataclass(frozen=True)
class EmbeddedViewer:
    """Parts of a page that has the viewer inside; all are text."""

    script: str  # JavaScript of the viewer, which sets ``window.WebViewer``
    wasm: str
    recording: str  # packed as ``wasm`` is: gzip in base64


def embedded_viewer(recording: bytes) -> EmbeddedViewer:
    """The viewer with the bytes of a recording (.rrd)."""
    folder = viewer_folder()
    script = (folder / SCRIPT).read_text(encoding="utf-8")
    script, loads = FETCH.subn(lambda _: FROM_PAGE, script)
    script, exports = EXPORT.subn("", script)
    if not loads or not exports or "var WebViewer = class" not in script:
        expected = f"that of rerun-notebook {wanted()}"
        raise InputError(folder / SCRIPT, "a viewer that is built in another way", expected, how_to_install(wanted()))
    safe = script.replace("</script", "<\\/script")
    wasm = pack((folder / WASM).read_bytes(), level=6)
    return EmbeddedViewer(f"{safe}\nwindow.WebViewer = WebViewer;\n", wasm, pack(recording))


def wanted() -> str:
    """Version of the viewer that reads our recordings: that of the library that writes them."""
    try:
        return version("rerun-sdk")
    except PackageNotFoundError:
        raise InputError("viewer", "no rerun-sdk", "the extra view", "pip install 'leapgap[view]'") from None


def how_to_install(needed: str) -> str:
    """What to do where the viewer of a version is missing."""
    return f"pip install --no-deps rerun-notebook=={needed}, or choose the viewer light"


def viewer_folder() -> Path:
    """Folder of the viewer's files; ``InputError`` where the package is absent or of another version."""
    spec, needed = find_spec("rerun_notebook"), wanted()
    do = how_to_install(needed)
    if spec is None or spec.origin is None:
        raise InputError("viewer", "embedded without the package rerun-notebook", f"version {needed} of it", do)
    there = version("rerun-notebook")
    if there != needed:
        raise InputError("viewer", f"rerun-notebook {there}", f"version {needed}, as rerun-sdk", do)
    return Path(spec.origin).parent / "static"
