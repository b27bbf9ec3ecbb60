#!/usr/bin/env bash
# Run a command with ROS, the workspace and the virtual environment set up.
# The set-up files use variables that may be unset: no `set -u` here.
source /opt/ros/jazzy/setup.bash
[[ -f /deepseis/install/setup.bash ]] && source /deepseis/install/setup.bash
export PATH="/opt/venv/bin:$PATH"
exec "$@"
