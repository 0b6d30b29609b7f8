"""netconvert."""

from netconvert.machine_code import forget_outdated

forget_outdated()
