"""Where the command ``leapgap`` begins: Ctrl-C is heard before the rest is imported."""

import sys

from leapgap.runtime.interrupt import hear_early


def main() -> int:
    """Run the command; its exit code."""
    hear_early()
    from leapgap import cli

    return cli.main()


if __name__ == "__main__":
    sys.exit(main())
