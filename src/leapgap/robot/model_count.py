"""Counts what a model file asks for, before MuJoCo sees it: in a process of its own, by the standard library alone.

``main`` reads a JSON object from its standard input (``path``; ``text``, to count that in place of the file's) and
writes one: ``refused``, the four parts of an ``InputError``, or what was counted.

The XML is tokenised as MuJoCo's own reader does it: what that one takes for a comment, a tag or the value of an
attribute is the same here. What expat and MuJoCo would read differently is refused: document types, bytes that are no
UTF-8. Then expat reads it, element by element.
"""

import json
import math
import os
import re
import stat
import struct
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NoReturn
from xml.parsers import expat

LARGEST_XML_BYTES = 64 << 20
LARGEST_FILE_BYTES = 256 << 20
LARGEST_TOTAL_BYTES = 1 << 30  # largest size of a model file, of a mesh, height field or texture, and of all
LARGEST_MODEL_BYTES = 1 << 30  # largest size of a compiled model, with the working memory of its simulation
MOST_ELEMENTS = 200_000  # largest number of elements once ``replicate`` and ``composite`` have multiplied them
DEEPEST = 200  # largest number of elements inside one another
MOST_FILES, MOST_TRIES = 2000, 200_000  # largest number of files, and of places where they are looked for
ELEMENT_BYTES, LEVEL_BYTES, NUMBER_BYTES = 500, 40, 8  # what an element takes, more for each level above, and a number
VERTEX_BYTES, PIXEL_BYTES, CELL_BYTES = 450, 4, 4
"""What a vertex of a built-in mesh takes with its hull, a pixel of a texture and a cell of a height field."""
ORDINARY_ELEMENTS, ORDINARY_BYTES, ORDINARY_FILE_BYTES = 3000, 64 << 20, 128 << 20
"""A model that is no larger than this, and of elements that make nothing else large, compiles in seconds."""
COPIES = {"replicate": ("count", 1), "composite": ("count", 3), "flexcomp": ("count", 5)}
"""Elements that stand for as many as the product of an attribute says, times the elements of each."""
LENGTHS: Mapping[str, tuple[tuple[tuple[str, ...], float, float], ...]] = {
    "hfield": ((("nrow", "ncol"), 4e6, CELL_BYTES),),
    "texture": ((("width", "height"), 6.4e7, PIXEL_BYTES),),
    "numeric": ((("size",), 1e6, NUMBER_BYTES),),
    "user": ((("dim",), 1e6, NUMBER_BYTES), (("nsample",), 1e6, NUMBER_BYTES)),
    "sensor": ((("nsample",), 1e6, NUMBER_BYTES),),
    "contact": ((("num",), 1e4, 20 * NUMBER_BYTES),),
    "camera": ((("resolution",), 1e7, 0),),
    "mesh": ((("maxhullvert",), 1e6, 0), (("octree_maxdepth",), 10.0, 0)),
    "size": (
        *(((name,), 1e6, NUMBER_BYTES) for name in ("nuserdata", "nkey", "njmax", "nconmax", "nstack")),
        (("memory",), float(1 << 30), 1),
    ),
}
"""Element → its attributes whose product is bounded, the bound, and the bytes of one unit."""
USER = re.compile("nuser_.+")
MOST_USER = 1e6  # attributes of ``size`` that give each element of a kind so many numbers, and the most of them
MOST_RESOLUTION = 250.0  # largest number that says how finely a built-in mesh is divided
FILES = ("file", "filename", *(f"file{side}" for side in ("right", "left", "up", "down", "front", "back")))
"""Attributes that name a file."""
FOLDERS = ("meshdir", "texturedir", "assetdir")
NAMES_XML = ("include", "model")  # elements whose file is a model file, too
UNITS = {"k": 1 << 10, "m": 1 << 20, "g": 1 << 30, "t": 1 << 40, "p": 1 << 50, "e": 1 << 60}
NUMBER = re.compile(r"([0-9][0-9.]*(?:[eE][-+]?[0-9]+)?)\s*([kKmMgGtTpPeE]?)(?![0-9])")
CONTROL = re.compile("[\x00-\x1f\x7f-\x9f\u200e\u200f\u2028-\u202e\u2066-\u2069\ufffd]")
"""What no name holds: characters that move the cursor or turn the direction of a line, and bytes that are no text."""
UNUSUAL = {
    *("replicate", "composite", "flexcomp", "attach", "model", "skin", "flex", "deformable", "lengthrange"),
    *("plugin", "extension", "config", "instance"),
}
"""Elements whose cost does not show in their number."""
COMMENT, CDATA, DECLARATION, OTHER = b"<!--", b"<![CDATA[", b"<?", b"<!"
ENDS = {COMMENT: b"-->", CDATA: b"]]>", DECLARATION: b"?>"}
TAG = re.compile(rb"""<(?:[^<>"']++|"[^"]*+"|'[^']*+')*+>""")
QUOTED = re.compile(rb""""[^"]*"|'[^']*'""")
BREAK = re.compile(rb"[\t\r\n]")
PNG = b"\x89PNG\r\n\x1a\n"
LFS = b"version https://git-lfs"
MOST_PIXELS = 6.4e7
A_MODEL = "a MuJoCo model (XML) or a URDF"
DO = "correct the file, or name another"
MEMORY_BYTES, TIME_S = 1 << 30, 10  # limits of the process that counts


class RefusedError(Exception):
    """What is refused, in the four parts of an ``InputError``."""

    def __init__(self, where: object, found: str, expected: str, do: str = DO) -> None:
        self.parts = [str(where), found, expected, do]
        super().__init__(found)


@dataclass
class Count:
    """What was counted of a model file and of the files that it includes."""

    top: str = ""  # the top element: ``mujoco`` or ``robot``
    elements: float = 0.0
    bytes: float = 0.0
    unusual: bool = False
    users: dict[str, float] = field(default_factory=dict)  # kind of element → numbers of the user that each has
    keys: float = 0.0
    pixels: float = 0.0  # of the largest camera
    range_finders: float = 0.0
    attached: float = 0.0
    of_models: float = 0.0  # copies of attached models, and elements in all of them
    file_bytes: int = 0
    folders: dict[str, None] = field(default_factory=lambda: {"": None})
    parents: dict[Path, None] = field(default_factory=dict)
    named: list["Named"] = field(default_factory=list)
    tried: dict[str, list[int] | None] = field(default_factory=dict)
    """Every place where a file was looked for, and what is there: mode, size, time of change, number."""
    files: set[Path] = field(default_factory=set)

    def total_bytes(self) -> float:
        """Upper estimate of the bytes of the compiled model."""
        users, width = sum(self.users.values()) * self.elements, 16 * NUMBER_BYTES
        beams = self.range_finders * max(1.0, self.pixels)
        return self.bytes + NUMBER_BYTES * (users + beams) + width * self.keys * min(self.elements, 1e4)

    def is_ordinary(self) -> bool:
        """Whether it surely compiles in seconds and in little memory."""
        small = self.elements <= ORDINARY_ELEMENTS and self.total_bytes() <= ORDINARY_BYTES
        return small and not self.unusual and self.file_bytes <= ORDINARY_FILE_BYTES


@dataclass
class Named:
    """A name of a file in a model file."""

    name: str
    tag: str
    path: Path  # the model file that names it
    inside: tuple[Path, ...]
    copies: float
    depth: int
    tried: set[tuple[Path, str]] = field(default_factory=set)


def count(path: Path, text: bytes | None = None) -> Count:
    """Count a model file, or a text as if it stood there; ``RefusedError`` where it is none, or asks for too much."""
    found = Count()
    found.parents[path.parent] = None
    data = read_xml(path, path, found) if text is None else text
    Reader(found, path, (path.resolve(),), 1.0, 0).read(data)
    while follow(found):
        pass
    found.elements += found.attached * found.of_models
    if found.elements > MOST_ELEMENTS:
        raise RefusedError(path, f"{found.elements:.3g} elements after replication", f"{MOST_ELEMENTS} at most")
    if found.total_bytes() > LARGEST_MODEL_BYTES:
        says = f"a model of {found.total_bytes() / (1 << 20):.3g} MiB"
        raise RefusedError(path, says, f"{LARGEST_MODEL_BYTES >> 20} MiB at most")
    return found


class Reader:
    """Reads one file, element by element, and adds what is in it to the count."""

    def __init__(self, found: Count, path: Path, inside: tuple[Path, ...], copies: float, depth: int) -> None:
        self.count, self.path, self.inside = found, path, inside
        self.copies, self.outer = [copies], depth

    def read(self, data: bytes, named_in: Path | None = None) -> None:
        """Read an XML text; ``RefusedError`` where it is none, at the file that names it."""
        parser = expat.ParserCreate("utf-8")
        parser.StartElementHandler = self.start
        parser.EndElementHandler = lambda _: self.copies.pop()
        try:
            for token in tokens(data):
                parser.Parse(token.encode())
            parser.Parse(b"", True)
        except (expat.ExpatError, ValueError) as error:
            of = "" if named_in is None else f" in {self.path}"
            found = f"no valid MuJoCo model{of} ({' '.join(str(error).split())})"
            raise RefusedError(named_in or self.path, found, A_MODEL, "repair it") from None

    def start(self, tag: str, attributes: dict[str, str]) -> None:
        """Count an element."""
        found, copies, depth = self.count, self.copies[-1], self.outer + len(self.copies) - 1
        found.top = found.top or tag
        if depth > DEEPEST:
            raise RefusedError(self.path, f"elements more than {DEEPEST} deep in one another", "fewer")
        if tag in COPIES:
            name, parts = COPIES[tag]
            own = product(attributes.get(name, "1")) * parts
            if not own <= MOST_ELEMENTS:
                raise RefusedError(self.path, f"{tag} with {name}={shown(attributes[name])}", "fewer copies")
            copies *= own
        self.copies.append(copies)
        found.elements += copies
        if found.elements > MOST_ELEMENTS:
            says = f"more than {MOST_ELEMENTS} elements after replication, at {tag}"
            raise RefusedError(self.path, says, f"{MOST_ELEMENTS} at most")
        found.bytes += copies * (ELEMENT_BYTES + LEVEL_BYTES * depth + sum(map(len, attributes.values())))
        found.unusual |= tag in UNUSUAL
        self.add_sizes(tag, attributes, copies)
        for name, value in attributes.items():
            if name in FOLDERS and tag == "compiler":
                found.folders[value] = None
            elif name in FILES or name in ("name", "model"):
                if CONTROL.search(value):
                    says = f"{tag} with {name}={value!a:.80}"
                    raise RefusedError(self.path, says, "names of printable characters")
                if name in FILES:
                    found.named.append(Named(value, tag, self.path, self.inside, copies, depth + 1))

    def add_sizes(self, tag: str, attributes: Mapping[str, str], copies: float) -> None:
        """Add what an element makes large beyond itself."""
        found = self.count
        for names, bound, unit in LENGTHS.get(tag, ()):
            if any(name in attributes for name in names):
                size = math.prod(product(attributes.get(name, "1")) for name in names)
                self.bound(tag, attributes, names, size, bound)
                found.bytes += copies * unit * size
        if tag == "size":
            for name in filter(USER.fullmatch, attributes):
                self.bound(tag, attributes, (name,), product(attributes[name]), MOST_USER)
                found.users[name] = max(found.users.get(name, 0.0), product(attributes[name]))
            found.keys = max(found.keys, product(attributes.get("nkey", "0")))
        elif tag == "key":
            found.keys += copies
        elif tag == "camera":
            found.pixels = max(found.pixels, product(attributes.get("resolution", "1")))
        elif tag == "rangefinder":
            found.range_finders += copies
        elif tag == "attach":
            found.attached += copies
        elif tag == "config":
            found.bytes += copies * NUMBER_BYTES * product(attributes.get("value", "1"))
        elif tag == "mesh" and "builtin" in attributes:
            found.unusual = True
            finest = max([1.0, *numbers(attributes.get("params", ""))])
            self.bound(tag, attributes, ("params",), finest, MOST_RESOLUTION)
            found.bytes += VERTEX_BYTES * finest**2
        found.unusual |= tag == "mesh" and "octree_maxdepth" in attributes
        if "user" in attributes:
            found.users[tag] = max(found.users.get(tag, 0.0), float(len(attributes["user"].split())))

    def bound(self, tag: str, attributes: Mapping[str, str], names: tuple[str, ...], size: float, most: float) -> None:
        """``RefusedError`` for a size above its bound."""
        if not size <= most:
            said = ", ".join(f"{name}={shown(attributes[name])}" for name in names if name in attributes)
            raise RefusedError(self.path, f"{tag} with {said}", f"a size of {most:g} at most")


def tokens(data: bytes) -> Iterator[str]:
    """The text without comments and declarations; breaks in values are written out, which expat would take for spaces.

    ``ValueError`` for what is no XML, or which expat and MuJoCo would read differently.
    """
    at, data = 0, data.removeprefix(b"\xef\xbb\xbf")
    while (begin := data.find(b"<", at)) >= 0:
        yield data[at:begin].decode(errors="replace")
        kind = next((one for one in ENDS if data.startswith(one, begin)), None)
        if kind is None:
            tag = None if data.startswith(OTHER, begin) else TAG.match(data, begin)
            if tag is None:
                what = "a document type" if data.startswith(OTHER, begin) else "a tag that does not end"
                raise ValueError(f"{what}, at byte {begin}")
            raw = tag[0]
            if BREAK.search(raw):
                raw = QUOTED.sub(written_out, raw)
            yield raw.decode(errors="replace")
            at = tag.end()
            continue
        end = data.find(ENDS[kind], begin + len(kind))
        if end < 0:
            raise ValueError(f"{kind.decode()} that does not end, at byte {begin}")
        at = end + len(ENDS[kind])
        yield data[begin:at].decode(errors="replace") if kind == CDATA else "\n" * data.count(b"\n", begin, at)
    yield data[at:].decode(errors="replace")


def written_out(value: re.Match[bytes]) -> bytes:
    """A quoted value whose tabs and line ends are references to these characters."""
    return BREAK.sub(lambda found: b"&#%d;" % found[0][0], value[0])


def numbers(text: str) -> list[float]:
    """The numbers of an attribute such as ``10 10 1`` or ``2G``."""
    try:
        return [float(value) * UNITS.get(unit.lower(), 1) for value, unit in NUMBER.findall(text)]
    except (ValueError, OverflowError):
        return [math.inf]


def product(text: str) -> float:
    """Their product, in which none is below 1."""
    return math.prod(max(1.0, one) for one in numbers(text))


def shown(text: str) -> str:
    """An attribute's value as a message shows it."""
    return text if len(text) <= 40 and text.isprintable() else ascii(text[:40])


def follow(found: Count) -> bool:
    """Check the named files in all folders known by now; whether any place was new."""
    new = False
    for one in tuple(found.named):
        if not one.name or "\0" in one.name or one.name.startswith("package://"):
            continue
        plain = one.name.removeprefix("file://")
        for parent in tuple(found.parents):
            for folder in tuple(found.folders):
                for inner in dict.fromkeys((plain, Path(plain).name)):
                    place = (parent, os.path.join(folder, inner))  # noqa: PTH118  an absolute one stays so
                    if inner and place not in one.tried:
                        one.tried.add(place)
                        new = True
                        check_named(one, parent / place[1], inner == plain, found)
    return new


def check_named(one: Named, path: Path, is_meant: bool, found: Count) -> None:
    """Check a file that an element names, and what is in it if it is a model file; one that is missing is no matter."""
    if len(found.tried) > MOST_TRIES:
        raise RefusedError(one.path, f"files in more than {MOST_TRIES} places", "fewer files or folders")
    try:
        path = path.resolve()
        signature = signature_of(path)
    except (OSError, RuntimeError, ValueError):  # a name that is too long, links in a circle
        return
    found.tried[str(path)] = signature
    if signature is None or (not is_meant and not stat.S_ISREG(signature[0])):
        return
    is_xml = one.tag in NAMES_XML
    size = plain_size(path, one.path, LARGEST_XML_BYTES if is_xml else LARGEST_FILE_BYTES)
    if is_xml:
        if path in one.inside:
            chain = " includes ".join(each.name for each in (*one.inside[one.inside.index(path) :], path))
            raise RefusedError(one.path, f"files that include themselves: {chain}", "an end", "remove the inclusion")
        found.parents[path.parent] = None
        before = found.elements
        Reader(found, path, (*one.inside, path), one.copies, one.depth).read(read_xml(path, path, found), one.path)
        found.of_models += found.elements - before if one.tag == "model" else 0.0
    elif path not in found.files:
        # ``RefusedError`` for a file that stands for another, or whose first bytes claim more than a picture has
        with path.open("rb") as file:
            head = file.read(len(LFS) + 1)
        check_no_pointer(head, path, one.tag, one.path)
        if head.startswith(PNG) and len(head) == 24:
            width, height = struct.unpack(">II", head[16:24])
            if width * height > MOST_PIXELS:
                raise RefusedError(one.path, f"{path.name} of {width} × {height} pixels", f"{MOST_PIXELS:g} at most")
            found.bytes += PIXEL_BYTES * width * height
        if one.tag == "flexcomp":  # each point of it is a body with three joints
            found.elements += one.copies * size / 12
            if found.elements > MOST_ELEMENTS:
                raise RefusedError(
                    one.path, f"flexcomp of the points in {path.name}", f"{MOST_ELEMENTS} elements at most"
                )
        found.file_bytes += size
    found.files.add(path)
    if found.file_bytes > LARGEST_TOTAL_BYTES or len(found.files) > MOST_FILES:
        said = f"{len(found.files)} files of {found.file_bytes >> 20} MiB together"
        raise RefusedError(one.path, said, f"{MOST_FILES} files of {LARGEST_TOTAL_BYTES >> 20} MiB at most")


def signature_of(path: Path) -> list[int] | None:
    """What shows that a file is another one, or has changed; None where there is none."""
    try:
        status = path.stat()
    except (FileNotFoundError, NotADirectoryError):
        return None
    return [status.st_mode, status.st_size, status.st_mtime_ns, status.st_ino]


def read_xml(path: Path, where: object, found: Count) -> bytes:
    """The bytes of an XML file; ``RefusedError`` where it is no plain file, or too large."""
    if not os.path.lexists(path) or not path.exists():
        raise RefusedError(where, "no such file", A_MODEL, "name the robot's model file")
    if plain_size(path, where, LARGEST_XML_BYTES) == 0:
        raise RefusedError(where, "an empty file", A_MODEL, "name the robot's model file")
    found.tried[str(path.resolve())] = signature_of(path)
    data = path.read_bytes()
    check_no_pointer(data, path, "model", where)
    return data


def plain_size(path: Path, where: object, largest: int) -> int:
    """Size of a plain file; ``RefusedError`` for anything else, which may never end, and for one above ``largest``."""
    status = path.stat()
    if not stat.S_ISREG(status.st_mode):
        kind = "a folder" if stat.S_ISDIR(status.st_mode) else "no plain file (a pipe, a socket or a device)"
        raise RefusedError(where, f"{path} is {kind}" if path != where else kind, "a plain file", "name the file")
    if status.st_size > largest:
        raise RefusedError(where, f"{path} has {status.st_size >> 20} MiB", f"{largest >> 20} MiB at most")
    return status.st_size


def check_no_pointer(head: bytes, path: Path, kind: str, where: object) -> None:
    """``RefusedError`` where the first bytes of a file are those of a pointer of git-LFS."""
    if head.startswith(LFS):
        says = f"{path.name}, which is no {kind} but the pointer to one that git-LFS keeps"
        raise RefusedError(where, says, "the file itself", "fetch it: git lfs pull")


def limit_process(memory_bytes: int, time_s: int) -> None:
    """Bound the memory and the time of this process, where the system can."""
    try:
        import resource
    except ImportError:
        return
    for kind, most in ((resource.RLIMIT_AS, memory_bytes), (resource.RLIMIT_CPU, time_s)):
        try:
            hard = resource.getrlimit(kind)[1]
            most = most if hard == resource.RLIM_INFINITY else min(most, hard)
            resource.setrlimit(kind, (most, hard))
        except (OSError, ValueError):  # macOS bounds no addresses
            continue


def answer(asked: Mapping[str, Any]) -> dict[str, Any]:
    """What the process says of a model file."""
    path, text = Path(asked["path"]), asked.get("text")
    try:
        found = count(path, None if text is None else text.encode(errors="surrogateescape"))
    except RefusedError as refused:
        return {"refused": refused.parts}
    except OSError as error:
        return {"refused": [str(path), f"a file that cannot be read ({error.strerror or error})", A_MODEL, DO]}
    return {"top": found.top, "ordinary": found.is_ordinary(), "tried": found.tried}


def main() -> NoReturn:
    """Answer one question."""
    limit_process(MEMORY_BYTES, TIME_S)
    said = answer(json.loads(sys.stdin.buffer.read()))
    sys.stdout.write(json.dumps(said))
    sys.stdout.flush()
    os._exit(0)
