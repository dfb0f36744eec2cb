"""The script that starts a container: ROS and the workspace are sourced, then the command takes its place."""

from collections.abc import Iterator

from calibration.image.specification import Recipe

_RESULT = {"catkin_make": "devel/setup.bash", "colcon": "install/setup.bash"}


def entrypoint_script(recipe: Recipe) -> str | None:
    """Write the script, or None where there is nothing to do before the command. It prints nothing."""
    lines = [*(f"source {file}" for file in sourced(recipe)), *recipe.entrypoint]
    if not lines:
        return None
    return "\n".join(["#!/bin/bash", "set -e", *lines, 'exec "$@"']) + "\n"


def sourced(recipe: Recipe, *, built: bool = True) -> Iterator[str]:
    """The files that a shell sources; that of the workspace once it is built."""
    if recipe.ros is not None:
        yield f"/opt/ros/{recipe.ros}/setup.bash"
    if recipe.workspace is not None and built:
        yield f"{recipe.workspace.path}/{_RESULT[recipe.workspace.tool]}"
