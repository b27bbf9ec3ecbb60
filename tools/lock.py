"""Renew requirements.lock from requirements.in: `python3.11 tools/lock.py [pip options]`.

Asks pip what it would install into an empty environment. Python 3.11 gives versions that 3.12
can use too. (`pip freeze` would not do: the ROS wheels carry metadata of packages no index has.)
"""

import json
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
HEADER = (
    "# Exact versions for Python 3.11 and 3.12 on x86-64, from requirements.in by tools/lock.py.\n"
)


def main() -> None:
    """Resolve in a scratch environment and write the pins."""
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run([sys.executable, "-m", "venv", folder], check=True)
        report = Path(folder) / "report.json"
        pip = [f"{folder}/bin/python", "-m", "pip", "install", "--quiet"]
        options = ["--dry-run", "--ignore-installed", "--report", str(report), *sys.argv[1:]]
        subprocess.run([*pip, *options, "-r", str(ROOT / "requirements.in")], check=True)
        chosen = [item["metadata"] for item in json.loads(report.read_text())["install"]]
    pins = sorted(
        f"{item['name'].lower().replace('_', '-')}=={item['version']}" for item in chosen
    )
    (ROOT / "requirements.lock").write_text(HEADER + "\n".join(pins) + "\n")


if __name__ == "__main__":
    main()
