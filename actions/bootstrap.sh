#!/usr/bin/env bash
# Finds a Python >= 3.11 and hands over to bootstrap.py, which takes the arguments.
#
# In order: the one given (INPUT_PYTHON); those on PATH; those that GitHub's machines keep in their tool cache (the
# `python3` of Ubuntu 22.04, and so of ROS 2 Humble, is 3.10); one that uv has brought. Nothing on PATH is changed for the
# steps that follow.
set -euo pipefail
shopt -s nullglob

here=$(cd -- "$(dirname -- "${BASH_SOURCE[0]}")" && pwd)
tools=${RUNNER_TOOL_CACHE:-${AGENT_TOOLSDIRECTORY:-/nonexistent}}/Python
candidates=(python3 python3.{14,13,12,11} "$tools"/3.{14,13,12,11}.*/*/bin/python3 of-uv)
problem="no Python >= 3.11 on this machine: add before this step actions/setup-python, or where there is pip (a container of ROS 2 Humble): python3 -m pip install uv && uv python install 3.11; or name one (input 'python')"
status=3
if [[ -n ${INPUT_PYTHON:-} ]]; then
    candidates=("$INPUT_PYTHON")
    problem="input 'python': what it names does not run as a Python >= 3.11; give the path of an interpreter, or leave it empty"
    status=2
fi

for python in "${candidates[@]}"; do
    if [[ $python == of-uv ]]; then
        python=$(uv python find --no-project --no-config --no-python-downloads '>=3.11' </dev/null 2>/dev/null) || continue
    fi
    if "$python" -I -c 'import sys; sys.exit(sys.version_info < (3, 11))' </dev/null &>/dev/null; then
        exec "$python" -I -u -X utf8 "$here/bootstrap.py" "$@"
    fi
done
# On stdout: an annotation where the runner reads the log, a plain line elsewhere.
if [[ ${GITHUB_ACTIONS:-} == true ]]; then printf '::error::'; fi
echo "$problem"
exit "$status"
