"""The command `hid2`: what it is made of is imported when it can be interrupted."""

import os
import signal
import sys

__all__ = ["main"]


def main() -> None:
    """Run the command; SIGINT, SIGTERM and SIGHUP end it cleanly from its first import on."""
    signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGINT, signal.SIGTERM, signal.SIGHUP))
    for number, name in ((0, "stdin"), (1, "stdout"), (2, "stderr")):
        if getattr(sys, name) is None:  # closed, as daemons do: no file of a batch may get its number
            os.dup2(os.open(os.devnull, os.O_RDWR), number)
            setattr(sys, name, os.fdopen(number, "r" if number == 0 else "w"))
    from bridge.interruption import SIGNALS, end_when_interrupted

    end_when_interrupted()
    try:
        from bridge.cli.commands import run
    except ModuleNotFoundError as error:  # a wheel that was installed without what it needs
        sys.exit(f"hid2: error: no module {error.name!r}, which hid2 needs: install it, INSTALL.md has a line for all")

    code = run()
    for number in SIGNALS:
        signal.signal(number, signal.SIG_IGN)  # it is done
    sys.exit(code)
