"""placeholder"""
from pathlib import Path


def sumo_folder(root: Path, split: str | None, new_id: str) -> Path:
    return root / (split or "") / new_id


def write_sumo(folder: Path, out: Path) -> None:
    raise NotImplementedError
