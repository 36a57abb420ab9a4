"""Package metadata: read by pip and by colcon (ament_python) alike."""

from pathlib import Path

from setuptools import find_packages, setup

NAME = "hd_diag"
FLEET = ["pyarrow>=17,<27", "ruptures>=1.1.9,<2"]


def share(folder: str) -> list[tuple[str, list[str]]]:
    """Pairs (target folder, [file]) that install a folder with its subfolders under share/hd_diag."""
    files = [path for path in sorted(Path(folder).rglob("*")) if path.is_file() and path.suffix != ".pyc"]
    return [(f"share/{NAME}/{path.parent.as_posix()}", [path.as_posix()]) for path in files]


setup(
    name=NAME,
    version="0.1.0",
    description="Backlash, tooth loads and transmission error of a harmonic drive, live and from bags",
    author="hd_diag contributors",
    license="Apache-2.0",
    keywords=["ROS", "harmonic drive", "strain wave gear", "transmission error", "diagnostics"],
    packages=find_packages(include=[NAME, f"{NAME}.*"]),
    package_data={
        NAME: ["py.typed"],
        f"{NAME}.config": ["parameters.csv"],
        f"{NAME}.gears": ["catalogue.csv"],
        f"{NAME}.report": ["templates/*"],
    },
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        *share("config"),
        *share("examples"),
        *share("launch"),
    ],
    zip_safe=False,
    python_requires=">=3.10",
    # Lower bounds: what Ubuntu 24.04 ships, or the oldest release known to work. The locks in requirements/
    # hold the exact versions that `make demo` and `make test` use.
    install_requires=[
        "numpy>=1.26,<3",
        "scipy>=1.11,<2",
        "numba>=0.59,<1",
        "PyYAML>=6.0,<7",
        "click>=8.1,<9",
        "rich>=13.7,<16",
        "mcap>=1.2.1,<2",
        "rosbags>=0.11,<0.12",
        "zstandard>=0.22,<1",
        "lz4>=4.0,<5",
        "matplotlib>=3.6,<4",
        "Jinja2>=3.1,<4",
    ],
    extras_require={
        # hd-diag fleet alone: a table as Parquet, steps of a series.
        "fleet": FLEET,
        # Where no ROS 2 Jazzy is installed: rclpy, rcl and Fast DDS as wheels.
        "ros": [
            "ros-jazzy-rclpy[fastrtps]==7.1.6",
            "ros-jazzy-common-interfaces==5.3.6",
        ],
        # hd-diag fleet on more than one machine.
        "cluster": [*FLEET, "distributed>=2024.8,<2027"],
        "test": [
            "distributed>=2024.8,<2027",
            "pytest>=7.4,<10",
            "pytest-timeout>=2.2,<3",
            "pytest-xdist>=3.4,<4",
            "hypothesis>=6.98,<7",
            "mcap-ros2-support>=0.5,<0.7",
            "selenium>=4.20,<5",
            "axe-core-python>=0.1,<0.2",
        ],
        # Plain methods that bench/challenge.py runs beside this package's, and what builds the tree there.
        "challenge": [
            "pysindy>=2.0,<3",
            "scikit-learn>=1.3,<2",
            "setuptools>=68,<85",
        ],
        # The pages in docs/: `make docs`.
        # The parsers of that page format have no release for both Python 3.10 and the newest rich.
        "docs": [
            "sphinx>=8.1,<10; python_version >= '3.11'",
            "myst-parser>=4.0,<6; python_version >= '3.11'",
            "numpydoc>=1.8,<2; python_version >= '3.11'",
            "furo>=2024.8,<2027; python_version >= '3.11'",
        ],
        "dev": [
            "colcon-common-extensions>=0.3,<0.4",
            "catkin-pkg>=1.0,<2",
            "packaging>=24,<27",
            "setuptools>=68,<85",
            "ruff>=0.12,<0.17",
            "mypy>=1.8,<3",
            "types-PyYAML>=6.0,<7",
        ],
    },
    entry_points={
        "console_scripts": [
            "hd-diag = hd_diag.__main__:main",
            "hd_diag_node = hd_diag.__main__:node",
        ],
    },
)
