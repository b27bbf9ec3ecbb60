"""Install deepseis_bringup."""

from pathlib import Path

from setuptools import find_packages, setup

PACKAGE = "deepseis_bringup"


def shared_files() -> list[tuple[str, list[str]]]:
    """List launch, parameter and scenario files for share/deepseis_bringup."""
    folders: dict[str, list[str]] = {}
    for folder in ("launch", "config", "scenarios"):
        for path in sorted(Path(folder).rglob("*.*")):
            folders.setdefault(f"share/{PACKAGE}/{path.parent}", []).append(str(path))
    return list(folders.items())


setup(
    name=PACKAGE,
    version="0.1.0",
    description="The graph, its parameters, recorder, replay, reports and the deepseis command.",
    license="Apache-2.0",
    maintainer="DeepSeis developers",
    maintainer_email="deepseis@posteo.net",
    packages=find_packages(include=[PACKAGE, f"{PACKAGE}.*"]),
    package_data={"": ["py.typed", "*.yaml", "*.csv", "*.txt", "*.json", "page/*"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (f"share/{PACKAGE}", ["package.xml"]),
        *shared_files(),
    ],
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    entry_points={
        "console_scripts": [
            "deepseis = deepseis_bringup.cli:main",
            "recorder = deepseis_bringup.nodes.recorder:main",
            "exporter = deepseis_bringup.nodes.exporter:main",
            "web = deepseis_bringup.nodes.web:main",
        ],
    },
)
