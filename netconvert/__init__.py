"""netconvert."""

from netconvert.machine_code import keep_compiled

keep_compiled()
