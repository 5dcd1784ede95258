"""The program `cloudtomo`, also as `python -m cloudtomo_cl`.

Nothing but `signal` is imported before Ctrl-C is taken from Python, which would answer it with a traceback.
"""

import signal


def main() -> None:
    """Runs the command line, and ends the process with its exit status."""
    # Until it listens, Ctrl-C ends it as any program, without a traceback from among the imports.
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    import atexit
    import os

    from cloudtomo_cl.commands import cli, streams

    streams.open_missing_descriptors()
    try:
        status = cli.main()
    except SystemExit as ended:  # of help, version, and options that are not understood
        status = ended.code if isinstance(ended.code, int) else int(ended.code is not None)
    # Not by way of the libraries' own endings: where a terminal or a pipe was closed, LLVM, which OpenCL drivers hold,
    # aborts the process for a warning that it could not write there, and the exit status is lost.
    atexit._run_exitfuncs()
    streams.flush()
    os._exit(status)


if __name__ == "__main__":
    main()
