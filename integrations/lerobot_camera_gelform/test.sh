#!/bin/sh
# Tests of the camera with LeRobot's own factory, writer and reader, outside the default suite: LeRobot and torch are 5.5 GB.
#
#   ./test.sh [ENVIRONMENT]     a virtual environment of Python 3.12 or newer, made if it is not there; default: .venv here
#
# PYTHON names the Python to make it with. About 2 minutes once everything is installed.
set -eu
here=$(cd "$(dirname "$0")" && pwd)
repo=$(cd "$here/../.." && pwd)
environment=${1:-$here/.venv}

python312() {
    for one in "${PYTHON:-}" python3.12 "$HOME"/.pyenv/versions/3.12*/bin/python python3 python python3.13 python3.14 \
        "$HOME"/.pyenv/versions/3.1[3-9]*/bin/python; do
        if [ -n "$one" ] && command -v "$one" >/dev/null 2>&1 \
            && "$one" -c 'import sys; sys.exit(sys.version_info[:2] < (3, 12))' 2>/dev/null; then
            command -v "$one"
            return
        fi
    done
    echo "Expected Python 3.12 or newer, which LeRobot 0.6 needs, found none. Install it, or name it: PYTHON=/path/python3.12 $0" >&2
    exit 1
}

if [ ! -x "$environment/bin/python" ]; then
    found=$(python312)
    "$found" -m venv "$environment"
fi
python=$environment/bin/python
unset PYTHONPATH # what is tested is what is installed
if ! REPO=$repo HERE=$here "$python" -c '
import os
from importlib.metadata import version
from pathlib import Path
import gelform, lerobot, av, pytest, lerobot_camera_gelform as plugin
assert Path(gelform.__file__).is_relative_to(os.environ["REPO"])
assert Path(plugin.__file__).is_relative_to(os.environ["HERE"]) and version("lerobot_camera_gelform")
' 2>/dev/null; then
    "$python" -m pip install --quiet 'lerobot[dataset]>=0.6,<0.8' pytest -e "$repo" -e "$here"
fi
cd "$here"
exec "$python" -m pytest "$here/tests"
