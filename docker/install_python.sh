#!/usr/bin/env bash
# Make or extend a virtual environment on top of the system's Python:
#     install_python.sh VENV REQUIREMENTS
# Versions are those of requirements.lock, except of what the system has and ROS was built with
# (numpy, scipy, setuptools), and of ROS itself.
set -euo pipefail
venv="$1" requirements="$2"
root="$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd -P)"

[[ -x "$venv/bin/python" ]] || python3 -m venv --system-site-packages "$venv"
constraints="$(mktemp)"
trap 'rm -f "$constraints"' EXIT
grep -Ev '^(#|ros-|colcon|catkin|numpy==|scipy==|setuptools==)' "$root/requirements.lock" > "$constraints"
"$venv/bin/python" -m pip install --no-cache-dir --disable-pip-version-check \
    --constraint "$constraints" --requirement "$requirements"
