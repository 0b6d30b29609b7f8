"""COMPOSITION.toml: which scenes of which sources make which data sets. `bridge/forecasting/README.md` has examples."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationInfo, model_validator

from bridge.recordings.folders import SPLITS
from bridge.toml import parse_value
from netconvert.errors import ConfigError


def _counted(value: object) -> object:
    is_number = isinstance(value, int) and not isinstance(value, bool) and value >= 0
    if not (is_number or (isinstance(value, float) and 0 < value < 1) or value == "all"):
        raise ValueError("a number of scenes, a share of them between 0 and 1, or all")
    return value


def _placed(value: object, info: ValidationInfo) -> object:
    """The folders of a source, one or a list, which begin at the file's; what is neither is left for the check."""
    listed = [value] if isinstance(value, str) else value
    if info.context is None or not isinstance(listed, list) or not all(isinstance(place, str) for place in listed):
        return value
    return tuple(str(info.context / place) for place in listed)


#: Number of scenes, a share of those that there are, or all of them.
Count = Annotated[int | float | Literal["all"], BeforeValidator(_counted)]
Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.+-]{0,63}$")]
#: The control compositions by name, in the order of the tables, with what each is for.
CONTROLS: Mapping[str, str] = {
    "recorded": "recorded scenes only",
    "recorded-twice": "recorded, and as many as hid2 adds, drawn again",
    "recorded-dense": "recorded, and as many of the densest (copies where no others are left)",
    "no-interaction": "recorded, and scenes generated without interaction",
    "hid2": "recorded, and scenes generated",
}
#: The sixth one, for the paper's Table 2.
HID2_ONLY = "hid2-only"


class _Part(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, strict=True)


class Split(_Part):
    """What keeps training and validation apart: by place, or by the split folders of the sources."""

    by: Literal["place", "folder"] = "place"
    val: float = Field(default=0.1, ge=0, lt=1)
    test: float = Field(default=0.0, ge=0, lt=1)

    @model_validator(mode="after")
    def _check(self) -> "Split":
        if self.val + self.test >= 1:
            raise ValueError(f"val {self.val} + test {self.test}, expected less than 1")
        return self

    @property
    def shares(self) -> dict[str, float]:
        """Share of the scenes by split."""
        return dict(zip(SPLITS, (1 - self.val - self.test, self.val, self.test), strict=True))


class Draw(_Part):
    """Which scenes of one split are taken, by source.

    take: drawn in proportion to cities and densities; again: drawn from those taken, a second time, under ids of their
    own; densest: those with the most tracks among the others, and where there are no others, again.
    min_agents: only scenes with at least so many tracks, in all or at the observation's end.
    """

    take: Mapping[str, Count] = Field(default_factory=dict)
    again: Mapping[str, Annotated[int, Field(ge=0)]] = Field(default_factory=dict)
    densest: Mapping[str, Annotated[int, Field(ge=0)]] = Field(default_factory=dict)
    min_agents: int = Field(default=0, ge=0)
    min_agents_in: Literal["all", "observed"] = "all"

    @property
    def sources(self) -> tuple[str, ...]:
        """Names of the sources that are drawn from, each once."""
        return tuple(dict.fromkeys([*self.take, *self.again, *self.densest]))


class Controls(_Part):
    """The five control compositions and `hid2-only`, of three sources.

    scenes: recorded ones in each; added: scenes added to each, all: as many as both generated sources have.
    """

    recorded: str
    generated: str
    without_interaction: str
    scenes: Count = "all"
    added: Annotated[int, Field(ge=1)] | Literal["all"] = "all"

    def sets(self, added: int) -> dict[str, Draw]:
        """The composition of each control, with so many scenes added."""
        base: dict[str, Count] = {self.recorded: self.scenes}
        return {
            "recorded": Draw(take=base),
            "recorded-twice": Draw(take=base, again={self.recorded: added}),
            "recorded-dense": Draw(take=base, densest={self.recorded: added}),
            "no-interaction": Draw(take={**base, self.without_interaction: added}),
            "hid2": Draw(take={**base, self.generated: added}),
            HID2_ONLY: Draw(take={self.generated: added}),
        }


class Composition(_Part):
    """The whole file.

    sources: folders, one or several, by name; only: so many scenes of a source, drawn before the split; sets: training
    sets by name, ROOT/NAME/train, or ROOT/train where there is but one; validation: validation sets by name,
    ROOT/validation/NAME/val; the first of them is the val of every set. test: ROOT/[NAME/]test of every set.
    """

    seed: int = Field(default=0, ge=0)
    layout: Literal["av2", "qcnet"] = "av2"
    split: Split = Split()
    sources: Mapping[Name, Annotated[tuple[str, ...], BeforeValidator(_placed)]] = Field(min_length=1)
    only: Mapping[Name, Count] = Field(default_factory=dict)
    sets: Mapping[Name, Draw] = Field(default_factory=dict)
    controls: Controls | None = None
    validation: Mapping[Name, Draw] = Field(default_factory=dict)
    test: Draw = Draw()

    @model_validator(mode="after")
    def _check(self) -> "Composition":
        if not self.sets and self.controls is None:
            raise ValueError("neither sets nor controls, expected at least one training set")
        twice = set(self.sets) & {*CONTROLS, HID2_ONLY} if self.controls else set()
        if twice or "validation" in self.sets:
            raise ValueError(f"sets: the name {(sorted(twice) or ['validation'])[0]!r} is taken, expected another one")
        draws = {f"sets.{name}": draw for name, draw in self.all_sets(1).items()}
        draws |= {f"validation.{name}": draw for name, draw in self.validation.items()} | {"test": self.test}
        draws["only"] = Draw(take=self.only)
        for where, draw in draws.items():
            unknown = sorted(set(draw.sources) - set(self.sources))
            if unknown:
                raise ValueError(f"{where}: source {unknown[0]!r}, expected one of {', '.join(self.sources)}")
        return self

    def all_sets(self, added: int) -> dict[str, Draw]:
        """Training sets by name, the controls, with so many scenes added, before the others."""
        return (self.controls.sets(added) if self.controls else {}) | dict(self.sets)

    @property
    def nested(self) -> bool:
        """Whether every training set has a folder of its own in the root."""
        return self.controls is not None or len(self.sets) > 1


def composition_of_sources(texts: Sequence[str]) -> Composition:
    """One data set of SOURCE[:N] each, of which those for validation are drawn together. Errors: ConfigError."""
    sources: dict[str, tuple[str]] = {}
    only: dict[str, Any] = {}
    for number, text in enumerate(texts):
        place, separator, count = text.rpartition(":")
        if not separator or Path(text).exists():
            place, count = text, "all"
        name, value = f"source-{number}", parse_value(count)
        try:
            _counted(value)
        except ValueError as error:
            raise ConfigError(f"{text!r}: expected SOURCE or SOURCE:N, N being {error}") from None
        sources[name], only[name] = (place,), value
    sets = {"all": {"take": dict.fromkeys(sources, "all")}}
    only = {name: value for name, value in only.items() if value != "all"}
    return Composition.model_validate({"sources": sources, "only": only, "sets": sets, "validation": sets})
