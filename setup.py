"""Which packages there are; pyproject.toml has all else, and cannot tell this.

``scenes/`` stands beside the package here, and within it where it is installed.
"""

from setuptools import find_packages, setup

setup(
    packages=[*find_packages(include=["potmesil_mi*"]), "potmesil_mi.scenes"],
    package_dir={"potmesil_mi.scenes": "scenes"},
)
