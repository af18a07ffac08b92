#!/bin/sh
# The test suite in an environment of its own, with the lowest versions that pyproject.toml allows, or the highest:
#     sh tests/stress/versions.sh lowest-direct|highest PYTHON [ARGUMENTS OF PYTEST]
# e.g. `sh tests/stress/versions.sh lowest-direct 3.11 -n 2 tests/averaging`. Needs uv (pip install uv) and that Python.
set -eu
resolution=$1 python=$2
shift 2
cd "$(dirname "$0")/../.."
place=$(mktemp -d)
trap 'rm -rf "$place"' EXIT
uv venv -q --python "$python" "$place/venv"
uv pip compile -q --no-header --no-annotate --resolution "$resolution" --python "$place/venv/bin/python" --extra test \
    pyproject.toml -o "$place/versions.txt"
uv pip install -q --python "$place/venv/bin/python" -r "$place/versions.txt"
uv pip check --python "$place/venv/bin/python"
cat "$place/versions.txt"
# kernels compiled by one numba are no use to another
export NUMBA_CACHE_DIR="$place/kernels" PYTHONPATH="$PWD" PATH="$place/venv/bin:$PATH"
python -m pytest "$@"
