#!/usr/bin/env bash
# Sets up .venv and runs the tests; arguments go to pytest.
set -euo pipefail
cd "$(dirname "$0")/.."
. scripts/setup.sh
exec python -m pytest "$@"
