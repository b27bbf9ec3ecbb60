"""Install deepseis_frontend."""

from pathlib import Path

from setuptools import find_packages, setup

PACKAGE = "deepseis_frontend"


def shared_files() -> list[tuple[str, list[str]]]:
    """List launch, parameter and scenario files for share/deepseis_frontend."""
    folders: dict[str, list[str]] = {}
    for folder in ("launch", "config", "scenarios"):
        for path in sorted(Path(folder).rglob("*.*")):
            folders.setdefault(f"share/{PACKAGE}/{path.parent}", []).append(str(path))
    return list(folders.items())


setup(
    name=PACKAGE,
    version="0.1.0",
    description="IF sample formats and sources, IMU sources.",
    license="Apache-2.0",
    maintainer="DeepSeis developers",
    maintainer_email="deepseis@posteo.net",
    packages=find_packages(include=[PACKAGE, f"{PACKAGE}.*"]),
    package_data={"": ["py.typed", "*.yaml", "*.csv", "*.txt", "*.json"]},
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
            "imu_source = deepseis_frontend.nodes.imu_source:main",
            "ldv_source = deepseis_frontend.nodes.ldv_source:main",
            "base_source = deepseis_frontend.nodes.base_source:main",
            "if_source = deepseis_frontend.nodes.if_source:main",
        ],
    },
)
