#!/usr/bin/env bash
# Make or extend a virtual environment on top of the system's Python:
#     install_python.sh VENV REQUIREMENTS
# Versions are those of requirements.lock, except of ROS itself and of what ROS was built with:
# numpy and scipy stay the system's, pandas and xarray (tests only) are what goes with them.
set -euo pipefail
venv="$1" requirements="$2"
root="$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd -P)"

[[ -x "$venv/bin/python" ]] || python3 -m venv --system-site-packages "$venv"
constraints="$(mktemp)"
trap 'rm -f "$constraints"' EXIT
grep -Ev '^(#|ros-|colcon|catkin|(numpy|pandas|scipy|setuptools|xarray)==)' "$root/requirements.lock" > "$constraints"
"$venv/bin/python" - >> "$constraints" <<'END'
from importlib.metadata import PackageNotFoundError, version

for name in ("numpy", "scipy"):
    try:
        print(f"{name}=={version(name)}")
    except PackageNotFoundError:
        pass
END
"$venv/bin/python" -m pip install --no-cache-dir --disable-pip-version-check \
    --constraint "$constraints" --requirement "$requirements"
