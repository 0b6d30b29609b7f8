#!/bin/sh
# Makes .venv/ with the command hid2 and all that it needs, at the versions, and with the hashes, of requirements.txt.
# "sh setup.sh tests" adds sumo-gui, a virtual screen for it, a browser, and the tools of the tests; "sh setup.sh forecast"
# the small forecaster's torch, without CUDA unless UV_TORCH_BACKEND says so. Completed steps are skipped.
set -eu
UV_VERSION=0.13.8
cd "$(dirname "$0")"

fail() {
    echo "setup.sh: $*" >&2
    exit 1
}

case "${1:-}" in
"") ;;
tests) ;;
forecast) ;;
*) fail "unknown argument '$1', expected none, or: tests, forecast" ;;
esac

# A line every few seconds: one clock for all steps, so that none starts it anew. It goes when this script is gone.
(while sleep 3 >/dev/null 2>&1 && kill -0 $$ 2>/dev/null; do echo "setup.sh: still at work" >&2; done) &
clock=$!
trap 'kill "$clock" 2>/dev/null || true' EXIT

# A Python for .venv, and to bring uv into .uv: that of the machine, also where some environment is active.
LOCATE='import sys; fits = (3, 11, 1) <= sys.version_info < (3, 13)
print(sys.base_prefix + "/bin/python%d.%d" % sys.version_info[:2]) if fits else sys.exit(1)'
python=
for candidate in python3 python3.11 python3.12; do
    found=$("$candidate" -c "$LOCATE" 2>/dev/null) || continue
    if [ -x .uv/bin/uv ] || "$found" -m pip --version >/dev/null 2>&1; then
        python=$found
        break
    fi
done
[ -n "$python" ] || fail "found no Python 3.11 or 3.12 with pip: please install one"

# Shared libraries that the SUMO wheels need, virtual screen and browser: Debian's packages, where something is missing.
missing_packages() {
    [ "$(uname)" = Linux ] || return 0
    "$python" - "$@" <<'PYTHON'
import ctypes, shutil, sys

WANTED = {  # shared library -> Debian package
    "libX11.so.6": "libx11-6", "libXext.so.6": "libxext6", "libXrender.so.1": "libxrender1", "libGL.so.1": "libgl1",
    "libatomic.so.1": "libatomic1", "libexpat.so.1": "libexpat1", "libglib-2.0.so.0": "libglib2.0-0",
}
if "tests" in sys.argv:
    WANTED["libGLU.so.1"] = "libglu1-mesa"
for library, package in WANTED.items():
    try:
        ctypes.CDLL(library)
    except OSError:
        print(package)
if "tests" in sys.argv and not shutil.which("Xvfb"):
    print("xvfb libgl1-mesa-dri")
if "tests" in sys.argv and not shutil.which("chromium"):
    print("chromium")
PYTHON
}
# Root may install them; at a terminal of a machine of its own, where others may care what it has, when the answer is yes.
may_install() {
    [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null || return 1
    for mark in /.dockerenv /run/.containerenv; do [ ! -e "$mark" ] || return 0; done
    [ -z "${container:-}${KUBERNETES_SERVICE_HOST:-}${CI:-}" ] && [ -t 0 ] && [ -t 2 ] || return 0
    printf 'setup.sh: apt-get install %s? [y/N] ' "$packages" >&2
    read -r answer
    case "$answer" in [yY]*) ;; *) return 1 ;; esac
}
packages=$(missing_packages "$@" | tr '\n' ' ')
packages=${packages% }
if [ -n "$packages" ]; then
    if may_install; then
        echo "setup.sh: installing $packages" >&2
        # shellcheck disable=SC2086  # one word a package
        { # a list that cannot be renewed may still do
            apt-get -qq update || true
            DEBIAN_FRONTEND=noninteractive apt-get -qq -o DPkg::Lock::Timeout=300 install --no-install-recommends $packages
        } >/dev/null || fail "apt-get could not install $packages"
    elif [ -n "$(missing_packages)" ]; then
        fail "please install, then call this again (Debian's names): apt-get install --no-install-recommends $packages"
    else
        echo "setup.sh: the tests of sumo-gui and of hid2 view need more, and are skipped without:" \
            "apt-get install --no-install-recommends $packages" >&2
    fi
fi

case "$(.uv/bin/uv --version 2>/dev/null)" in
"uv $UV_VERSION"*) ;;
*)
    echo "setup.sh: fetching uv $UV_VERSION into .uv" >&2
    "$python" -m pip install -qq --disable-pip-version-check --upgrade --target .uv "uv==$UV_VERSION" ||
        fail "pip could not install uv $UV_VERSION into .uv; is there a network?"
    ;;
esac

# Where the usual cache cannot be written, one of our own; no Python is ever downloaded.
cache=$(.uv/bin/uv cache dir 2>/dev/null) && mkdir -p "$cache" 2>/dev/null && [ -w "$cache" ] ||
    export UV_CACHE_DIR="$PWD/.uv/cache"
export UV_PYTHON_DOWNLOADS=never
# The machine's certificates, as pip takes them: its network may have some of its own.
[ ! -e /etc/ssl/certs/ca-certificates.crt ] || export UV_SYSTEM_CERTS="${UV_SYSTEM_CERTS:-true}"

# .venv/.hid2 says for which place, and for which of the two files, the environment was made.
place="place $PWD"
made="pins $(cksum pyproject.toml requirements.txt | tr '\n' ' ')"
if ! .venv/bin/python -c "$LOCATE" >/dev/null 2>&1 ||
    { [ -f .venv/.hid2 ] && ! grep -qxF "$place" .venv/.hid2; }; then
    echo "setup.sh: making .venv, which takes a minute" >&2
    .uv/bin/uv venv -q --clear --python "$python" .venv || fail "uv could not make .venv"
fi
if ! grep -qxF "$made ${1:-}" .venv/.hid2 2>/dev/null; then
    wanted="--extra critics"
    if [ "${1:-}" = tests ]; then wanted="$wanted --extra gui --extra site --group dev"; fi
    torch=${UV_TORCH_BACKEND-cpu} # PyTorch's own list of wheels; empty, which uv itself refuses: that of all packages
    unset UV_TORCH_BACKEND
    # Byte code is written here, once: where PYTHONDONTWRITEBYTECODE is set every command would take 2 s more.
    install() {
        .uv/bin/uv pip install -q --compile-bytecode --python .venv/bin/python --constraints requirements.txt "$@"
    }
    echo "setup.sh: installing packages into .venv (1.3 to 2 GB, a minute or two)" >&2
    # shellcheck disable=SC2086  # several words
    install --require-hashes -r pyproject.toml $wanted &&
        install --no-deps --require-build-hashes --build-constraints requirements.txt -e . ||
        fail "uv could not install the packages into .venv; is there a network?"
    if [ "${1:-}" = forecast ]; then # PyTorch's wheels have other hashes than those of the list of all packages
        install -r pyproject.toml --extra forecast ${torch:+--torch-backend "$torch"} ||
            fail "uv could not install torch into .venv;" \
                "can PyTorch's list of wheels be reached? bridge/forecasting/README.md says what to do without"
    fi
    printf '%s\n' "$place" "$made " "$made ${1:-}" >.venv/.hid2
fi
.venv/bin/python -c 'import libsumo' >/dev/null || fail "SUMO's library cannot be loaded (see above)"
# Compiled once, so that no scene waits for it; says so where there is something to compile.
.venv/bin/python -m compileall -q netconvert hid2 bridge >/dev/null || true
.venv/bin/python -m hid2.kernels.compile || fail "the loops of hid2/kernels cannot be compiled (see above)"
echo "setup.sh: ready" >&2
