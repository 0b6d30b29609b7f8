"""TOML files as models: what is wrong is told with the file, the key at its place, the value and what is expected."""

from pathlib import Path
from typing import Annotated

import pytest
from pydantic import BaseModel, ConfigDict, Field

from bridge.toml import parse_value, read_toml_as
from netconvert.errors import ConfigError


class _Part(BaseModel):
    model_config = ConfigDict(extra="forbid")
    share: Annotated[float, Field(ge=0, le=1)] = 0.0


class _Whole(BaseModel):
    model_config = ConfigDict(extra="forbid")
    name: str
    part: list[_Part] = []


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "no key 'name'; expected name, part$"),
        ('name = "a"\ncolour = 1\n', "unknown key 'colour'; expected name, part$"),
        ('name = "a"\n[[part]]\ncolour = 1\n', r"unknown key 'part\.0\.colour'; expected share$"),
        ('name = "a"\n[[part]]\nshare = 2\n', r"part\.0\.share = 2, expected less than or equal to 1$"),
        ("name = [", "not TOML .*, expected a whole$"),
        ("a." * 30 + "b = 1", "a key of more than 20 parts"),
        ("name = 1" + "0" * 30, "an integer of more than 64 bit"),
    ],
)
def test_what_is_wrong_is_told_with_its_place(tmp_path: Path, text: str, said: str) -> None:
    path = tmp_path / "a.toml"
    path.write_text(text)
    with pytest.raises(ConfigError, match=f"^{path}: .*{said}"):
        read_toml_as(_Whole, path, "a whole")


@pytest.mark.parametrize(
    ("text", "value"), [("3", 3), (".5", 0.5), ("[1, 2]", [1, 2]), ("true", True), ("arterial", "arterial")]
)
def test_text_is_what_toml_has_or_itself(text: str, value: object) -> None:
    assert parse_value(text) == value
