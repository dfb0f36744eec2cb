#!/usr/bin/env bash
# Runs the tests of a workspace inside its container, and leaves their reports and coverage in a folder.
# Arguments: TOOL (or auto), WORKSPACE (or . for the working directory), OUTPUT, COVERAGE (none, python, gcov), and
# arguments for the tool. Needs bash and findutils only, since images are of any age.
set -u

tool=$1 workspace=$2 output=$3 coverage=$4
shift 4

fail() {
    echo "$1" >&2
    exit 2
}

find_tool() {
    if [[ -d .catkin_tools ]]; then
        echo catkin
    elif [[ -f .catkin_workspace || -f devel/setup.bash ]]; then
        echo catkin_make
    elif [[ -f build/COLCON_IGNORE || -f install/setup.bash ]]; then
        echo colcon
    elif [[ -f CTestTestfile.cmake || -f build/CTestTestfile.cmake ]]; then
        echo ctest
    elif compgen -G '*.py' >/dev/null || [[ -f pyproject.toml || -f setup.cfg || -d tests || -d test ]]; then
        echo pytest
    fi
}

collect() {
    trap - EXIT TERM
    # Reports of this run: XML that a test tool wrote, and empty files, which a tool that crashed has left.
    find . -type f -name '*.xml' -newer "$output/.started" -print0 |
        while IFS= read -r -d '' file; do
            if [[ ! -s $file ]] || head -c 4096 -- "$file" | grep -qE '<(testsuites?|Site)[ >]'; then
                cp --parents -- "$file" "$output/reports"
            fi
        done
    if [[ $coverage == gcov ]]; then
        find . -type f -name '*.gcda' -newer "$output/.started" -print0 |
            xargs -0 -r -n 20 gcov --json-format --stdout >"$output/coverage/gcov.json"
    elif [[ $coverage == python ]]; then
        find . -type f -name 'coverage.xml' -newer "$output/.started" -exec cp --parents -- {} "$output/coverage" \;
        if compgen -G "$output/.coverage*" >/dev/null; then
            python3 -m coverage combine --quiet
            python3 -m coverage lcov --quiet -o "$output/coverage/python.info"
        fi
    fi
    rm -rf -- "$output/.started" "$output"/.coverage*
    find "$output" -mindepth 1 -type d -empty -delete
}

cd -- "$workspace" 2>/dev/null || fail "there is no folder $workspace in the image (workspace)"
mkdir -p "$output/reports" "$output/coverage"
touch "$output/.started"
if [[ $tool == auto ]]; then
    tool=$(find_tool)
    [[ -n $tool ]] || fail "$PWD: found no workspace of catkin, colcon, ctest or pytest: give tool, or a command"
fi
set +u # setup files of ROS use variables that are not set
for file in devel/setup.bash install/setup.bash; do
    # shellcheck disable=SC1090 # of the image
    if [[ -f $file ]]; then source "$file"; fi
done
set -u

export COVERAGE_FILE="$output/.coverage"
case $tool in
colcon)
    command=(colcon test --return-code-on-test-failure --event-handlers console_cohesion+)
    if [[ $coverage == python ]]; then command+=(--pytest-with-coverage); fi
    ;;
catkin) command=(catkin test --no-status) ;;
catkin_make) command=(catkin_make run_tests) ;;
ctest)
    if [[ ! -f CTestTestfile.cmake ]]; then cd build 2>/dev/null || fail "$PWD: found no CTestTestfile.cmake: build it"; fi
    command=(ctest --output-on-failure --output-junit "$output/reports/ctest.xml")
    ;;
pytest)
    command=(python3)
    if [[ $coverage == python ]]; then command+=(-m coverage run --parallel-mode); fi
    # xunit1 names the file and the line of a test
    command+=(-m pytest -p no:cacheprovider -o junit_family=xunit1 "--junitxml=$output/reports/pytest.xml")
    ;;
*) fail "there is no tool $tool" ;;
esac

trap collect EXIT
trap 'kill -TERM "$running" 2>/dev/null; wait "$running"; exit 143' TERM # at a time limit: what is there is reported
echo "$PWD: ${command[*]} $*"
"${command[@]}" "$@" &
running=$!
wait "$running"
