#!/usr/bin/env bash
# Sets up .venv, checks style and types, and runs the tests; arguments go to pytest.
set -euo pipefail
cd "$(dirname "$0")/.."
. scripts/setup.sh
ruff check .
bash scripts/format.sh --check
mypy
# All tests by two processes, a file by one of them: kernels are compiled, and much of the host's work done, by one thread.
[ $# -gt 0 ] || set -- -n 2 --dist loadfile
exec python -m pytest "$@"
