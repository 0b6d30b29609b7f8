"""Where the real scenes lie: `$HID2_SHARED_DATA`, else beside the project."""

import os
from pathlib import Path

SHARED_DATA = Path(os.environ.get("HID2_SHARED_DATA") or Path(__file__).resolve().parents[3].joinpath("shared", "data"))
