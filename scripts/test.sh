#!/usr/bin/env bash
# Sets up .venv, checks style and types, and runs the tests; arguments go to pytest.
set -euo pipefail
cd "$(dirname "$0")/.."
. scripts/setup.sh
ruff check .
bash scripts/format.sh --check
mypy
exec python -m pytest "$@"
