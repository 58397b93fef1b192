"""Run the command line: ``python -m pellucid`` is the same as ``pellucid``."""

from .cli.main import pellucid


def main() -> None:
    """Enter the command line."""
    pellucid(prog_name="pellucid")


if __name__ == "__main__":
    main()
