#!/bin/sh
# Puts uv into .uv/ of this checkout and sees that the shared libraries which the SUMO wheels need are there.
# "sh setup.sh tests" also wants a virtual screen for the tests of sumo-gui. Nothing is done twice.
set -eu
cd "$(dirname "$0")"

[ -x .uv/bin/uv ] || python3 -m pip install -qq --disable-pip-version-check --target .uv uv

packages=$(python3 - "${1:-}" <<'PYTHON'
import ctypes, shutil, sys

WANTED = {  # shared library -> Debian package
    "libX11.so.6": "libx11-6", "libXext.so.6": "libxext6", "libXrender.so.1": "libxrender1", "libGL.so.1": "libgl1",
    "libatomic.so.1": "libatomic1", "libexpat.so.1": "libexpat1", "libglib-2.0.so.0": "libglib2.0-0",
}
for library, package in WANTED.items() if sys.platform == "linux" else ():
    try:
        ctypes.CDLL(library)
    except OSError:
        print(package)
if "tests" in sys.argv and sys.platform == "linux" and not shutil.which("Xvfb"):
    print("xvfb xauth libglu1-mesa libgl1-mesa-dri")
PYTHON
)
[ -n "$packages" ] || exit 0

# shellcheck disable=SC2086  # one word per package
set -- $packages
if [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null; then
    echo "setup.sh: installing $*" >&2
    { apt-get -qq update && DEBIAN_FRONTEND=noninteractive apt-get -qq install --no-install-recommends "$@"; } >/dev/null ||
        echo "setup.sh: could not install $*" >&2
else
    echo "setup.sh: please install: sudo apt-get install --no-install-recommends $*" >&2
fi
