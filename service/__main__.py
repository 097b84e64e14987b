"""``depthsr``, and ``python -m service``: the command, which may be interrupted as it is loaded."""

import sys


def main() -> int:
    """Run the command and return its exit status."""
    try:
        from service.cli import main as run
    except KeyboardInterrupt:
        sys.stderr.write("depthsr: interrupted\n")
        return 130
    return run()


if __name__ == "__main__":
    sys.exit(main())
