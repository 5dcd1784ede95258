#!/usr/bin/env bash
# Formats Python (ruff format) and OpenCL C (clang-format). --check changes nothing and fails if something would change.
set -euo pipefail
cd "$(dirname "$0")/.."
. scripts/setup.sh

python=(ruff format --quiet)
kernels=(clang-format -i)
if [ "${1:-}" = --check ]; then
    python=(ruff format --check)
    kernels=(clang-format --dry-run --Werror)
fi
failed=0
"${python[@]}" . || failed=1
find kernels scripts tests \( -name '*.cl' -o -name '*.h' -o -name '*.c' \) -print0 | xargs -0 "${kernels[@]}" || failed=1
exit $failed
