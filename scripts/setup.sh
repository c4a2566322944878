#!/bin/sh
# Make the virtual environment $VENV with $PYTHON and what the given locks hold (default: requirements.lock): with uv
# where it is on the PATH, otherwise with venv and pip.  Every archive is checked against its hash in the lock.
# Modules are compiled when they are used: compiling all of them takes longer than fetching them, and a fifth of the space.
set -eu

PYTHON=${PYTHON:-python3}
VENV=${VENV:-.venv}
[ $# -gt 0 ] || set -- requirements.lock

stop() {
    printf 'setup: %s\n' "$1" >&2
    printf '  to fix it: %s\n' "$2" >&2
    exit 2
}

command -v "$PYTHON" >/dev/null 2>&1 ||
    stop "there is no '$PYTHON' on the PATH" "install Python 3.11 or newer, or name one: make setup PYTHON=/path/to/python3"
"$PYTHON" -c 'import sys; sys.exit(sys.version_info < (3, 11))' ||
    stop "'$PYTHON' is $("$PYTHON" -V 2>&1); Python 3.11 or newer is needed" "name a newer one: make setup PYTHON=python3.12"

if command -v uv >/dev/null 2>&1; then
    [ -x "$VENV/bin/python" ] || uv venv --quiet --clear --no-python-downloads --python "$PYTHON" "$VENV"
    for lock; do uv pip install --quiet --python "$VENV/bin/python" --require-hashes -r "$lock"; done
    uv pip install --quiet --python "$VENV/bin/python" --no-deps --no-build-isolation -e .
else
    "$PYTHON" -c 'import ensurepip, venv' 2>/dev/null ||
        stop "'$PYTHON' cannot make a virtual environment" "sudo apt-get install python3-venv (Debian, Ubuntu), or install uv"
    if ! "$VENV/bin/python" -m pip --version >/dev/null 2>&1; then
        "$PYTHON" -m venv --clear "$VENV"
    fi
    for lock; do
        echo "setup: installing from $lock; this takes a minute or two the first time" >&2
        "$VENV/bin/python" -m pip install --quiet --disable-pip-version-check --no-compile --require-hashes -r "$lock"
    done
    "$VENV/bin/python" -m pip install --quiet --disable-pip-version-check --no-compile --no-deps --no-build-isolation -e .
fi
