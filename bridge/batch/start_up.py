"""How a process keeps the garbage collector from looking through what stays for good."""

import gc

#: Objects made between two collections of the young ones, and young ones between two of the older (gc.set_threshold).
#: Modules and types are made by the thousand as a process starts, and none of them is ever free.
COLLECT = (5_000, 20, 20)


def spare_the_collector() -> None:
    """Leave modules, types and compiled functions out of every collection: for a process that has imported its work.

    One scene leaves little behind that only the collector can free, so it also need not come as often.
    """
    gc.freeze()
    gc.set_threshold(*COLLECT)
    gc.enable()
