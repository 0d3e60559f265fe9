"""The version of the package."""


def installed_version() -> str:
    """The version that is installed; it takes a while to look up."""
    from importlib.metadata import version

    return version("potmesil_mi")
