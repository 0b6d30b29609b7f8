"""The command `hid2`: what it is made of is imported when it can be interrupted."""

import signal
import sys

__all__ = ["main"]


def main() -> None:
    """Run the command; SIGINT and SIGTERM end it cleanly from its first import on."""
    signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGINT, signal.SIGTERM))
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
