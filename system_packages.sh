#!/bin/sh
# Checks for the system libraries that GSRAIN needs; installs what is missing where it may, else prints the one line.
# With "tests" also for what tests skip without.
set -eu

missing=""
need() { # package, then a command that succeeds when the package is there
    package=$1
    shift
    "$@" >/dev/null 2>&1 || missing="$missing $package"
}
library() { # whether the dynamic linker finds a library
    "${PYTHON:-python3}" -c "import ctypes, sys; ctypes.CDLL(sys.argv[1])" "$1"
}

need python3-venv "${PYTHON:-python3}" -c "import ensurepip, venv"
need libegl1 library libEGL.so.1
need libegl-mesa0 sh -c 'ls /usr/share/glvnd/egl_vendor.d/*.json /etc/glvnd/egl_vendor.d/*.json 2>/dev/null | grep -q .'
need libgl1 library libGL.so.1
need libgl1-mesa-dri sh -c 'find /usr/lib /usr/local/lib -name "swrast_dri.so" -o -name "libgallium*.so" -o -name "libnvidia-eglcore*" 2>/dev/null | grep -q .'
need libxrender1 library libXrender.so.1
need xvfb command -v Xvfb
need xauth command -v xauth
if [ "${1:-}" = tests ] && { [ "$(id -u)" = 0 ] || [ -n "$missing" ]; }; then
    need chromium sh -c 'command -v chromium || command -v chromium-browser || command -v google-chrome'
    need libxtst6 library libXtst.so.6
    if [ "$(. /etc/os-release 2>/dev/null && echo "$VERSION_ID")" = 12 ]; then # Debian 13 has none any more
        need libosmesa6 library libOSMesa.so.8
    fi
fi
[ -n "$missing" ] || exit 0

line="apt-get update && apt-get install -y --no-install-recommends$missing"
if ! command -v apt-get >/dev/null 2>&1; then
    echo "Missing system packages (Debian's names):$missing. Install them with your package manager." >&2
    exit 1
elif [ "$(id -u)" = 0 ]; then
    echo "Installing$missing"
    export DEBIAN_FRONTEND=noninteractive
    apt-get update -qq && apt-get install -qq -y --no-install-recommends $missing >/dev/null
elif command -v sudo >/dev/null 2>&1 && sudo -n true 2>/dev/null; then
    echo "Installing$missing"
    sudo apt-get update -qq && sudo DEBIAN_FRONTEND=noninteractive apt-get install -qq -y --no-install-recommends $missing >/dev/null
else
    echo "Missing system packages. Run this once as root, then make again:" >&2
    echo "  $line" >&2
    exit 1
fi
