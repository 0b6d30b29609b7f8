"""What a scene's bytes depend on beside its request: the code, the libraries that it computes with, the machine."""

import hashlib
import platform
import re
from functools import cache
from importlib.metadata import version
from pathlib import Path

import bridge
import hid2
import netconvert


@cache
def code_sha256() -> str:
    """Digest of this program's source files, by their names in the packages; line ends of any system count the same."""
    digest = hashlib.sha256()
    for package in (netconvert, hid2, bridge):
        for place in package.__path__:
            for path in sorted(Path(place).rglob("*.py")):
                content = path.read_bytes().replace(b"\r\n", b"\n")
                digest.update(f"{package.__name__}/{path.relative_to(place).as_posix()} {len(content)}\n".encode())
                digest.update(content)
    return digest.hexdigest()


@cache
def code_version() -> str:
    """Version of the program with the begin of that digest, "0.1.0+3f2a...": edited code is another version."""
    return f"{version('hid2-sumo')}+{code_sha256()[:12]}"


@cache
def libraries() -> dict[str, str]:
    """Versions of numpy, numba and GEOS; SUMO says its own."""
    from shapely import geos_version_string  # not where scenes are only handed out

    return {"numpy": version("numpy"), "numba": version("numba"), "geos": geos_version_string}


@cache
def processor() -> str:
    """The processor as it names itself, e.g. "AMD EPYC 7763 64-Core Processor"; its architecture where it does not."""
    said = Path("/proc/cpuinfo")
    found = re.search(r"^model name\s*: *(.+)$", said.read_text(), re.MULTILINE) if said.is_file() else None
    return found[1] if found else platform.machine()
