#!/usr/bin/env bash
# Sets up .venv, checks style and types, and runs the tests; arguments go to pytest.
set -euo pipefail
cd "$(dirname "$0")/.."
. scripts/setup.sh
ruff check .
mypy
exec python -m pytest "$@"
