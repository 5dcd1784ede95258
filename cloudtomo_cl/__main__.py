"""The program `cloudtomo`, also as `python -m cloudtomo_cl`."""

import signal
import sys


def main() -> int:
    """Runs the command line; returns the exit status."""
    # Until it listens, Ctrl-C ends it as any program, without a traceback from among the imports.
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    from cloudtomo_cl.commands import cli, streams

    streams.open_missing_descriptors()
    return cli.main()


if __name__ == "__main__":
    sys.exit(main())
