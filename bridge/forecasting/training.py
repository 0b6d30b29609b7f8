"""Trains the small forecaster and forecasts with it. Needs the extra `forecast`.

Deterministic on a CPU: the same targets, parameters and seed give the same weights, interrupted or not; batches of an
epoch are drawn from the seed and the epoch's number. A GPU is used where there is one, and then bits may differ.
"""

import os
import zlib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch

from bridge.evaluation.predictions import Forecast
from bridge.files import beside, explained
from bridge.forecasting.features import Target
from bridge.forecasting.network import Batch, VectorNet, loss_of
from hid2.params import Forecasting
from netconvert.errors import ConfigError, ScenarioError

_STATE = ("model", "optimiser", "schedule", "update", "params", "seed", "targets")


def train(
    targets: Sequence[Target], checkpoint: Path, params: Forecasting, *, seed: int, resume: bool = False,
    on_update: Callable[[int, int], None] | None = None,
) -> VectorNet:  # fmt: skip
    """Train on the targets that have a future, to `params.updates`; a checkpoint is left every so many.

    resume: go on from the checkpoint, if there is one of the same training. Errors: ScenarioError where there is
    nothing to learn from, ConfigError for another training's checkpoint, ExportError.
    """
    data = [target for target in targets if target.future is not None]
    if not data:
        raise ScenarioError("nothing to train on: no scored or focal track with 60 future steps in the training scenes")
    device = _device()
    torch.manual_seed(seed)
    model: VectorNet = VectorNet(params).to(device)
    optimiser = torch.optim.AdamW(model.parameters(), lr=params.learning_rate, weight_decay=params.weight_decay)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, params.updates)
    done = 0
    identity = {"params": params.model_dump_json(), "seed": seed, "targets": _digest(data)}
    if resume and checkpoint.is_file():
        state = _load(checkpoint, device)
        differs = [name for name, value in identity.items() if state[name] != value]
        if differs:
            raise ConfigError(f"{checkpoint}: of another training ({', '.join(differs)} differ); choose another folder")
        model.load_state_dict(state["model"])
        optimiser.load_state_dict(state["optimiser"])
        schedule.load_state_dict(state["schedule"])
        done = state["update"]
    everything = _batch(data, device)
    per_epoch = -(-len(data) // params.batch)
    model.train()
    for update in range(done, params.updates):
        epoch, number = divmod(update, per_epoch)
        order = np.random.default_rng([seed, epoch]).permutation(len(data))
        rows = torch.from_numpy(order[number * params.batch : (number + 1) * params.batch]).to(device)
        batch = Batch._make(values[rows] for values in everything)
        futures, logits = model(batch)
        loss = loss_of(futures, logits, batch.future)
        if not torch.isfinite(loss):
            raise ScenarioError(f"update {update}: the loss is {float(loss)}, expected a finite number")
        optimiser.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(model.parameters(), 1.0)
        optimiser.step()
        schedule.step()
        if (update + 1) % params.checkpoint_every == 0 or update + 1 == params.updates:
            values = model.state_dict(), optimiser.state_dict(), schedule.state_dict(), update + 1
            _save(checkpoint, dict(zip(_STATE, values, strict=False)) | identity)
        if on_update is not None:
            on_update(update + 1, params.updates)
    return model


def forecast(model: VectorNet, targets: Sequence[Target], params: Forecasting) -> dict[str, Forecast]:
    """Forecasts of the focal tracks by scenario: probabilities (K,) and modes (K, 60, 2), m, in the city."""
    device = _device()
    focal = [target for target in targets if target.focal]
    found: dict[str, Forecast] = {}
    model.eval()
    with torch.no_grad():
        for start in range(0, len(focal), params.batch):
            part = focal[start : start + params.batch]
            futures, logits = model(_batch(part, device))
            shares = torch.softmax(logits.double(), dim=1).cpu().numpy()
            for target, modes, share in zip(part, futures.cpu().numpy(), shares, strict=True):
                found[target.scenario_id] = share / share.sum(), {target.track_id: target.to_city(modes)}
    return found


def be_deterministic(threads: int) -> None:
    """What a process does before it trains: so many threads, and only operations that give the same bits again."""
    os.environ.setdefault("CUBLAS_WORKSPACE_CONFIG", ":4096:8")
    torch.set_num_threads(threads)
    torch.use_deterministic_algorithms(True, warn_only=True)


def _digest(targets: Sequence[Target]) -> int:
    """Check sum of what is trained on, in its order."""
    total = 0
    for target in targets:
        total = zlib.crc32(f"{target.scenario_id} {target.track_id}".encode() + target.agents.tobytes(), total)
    return total


def _device() -> Any:  # noqa: ANN401
    return torch.device("cuda" if torch.cuda.is_available() else "cpu")


def _batch(targets: Sequence[Target], device: Any) -> Batch:  # noqa: ANN401
    """The targets' arrays by name; None where one of them lacks it, as futures of forecasts may be."""
    columns = ([getattr(target, name) for target in targets] for name in Batch._fields)
    return Batch._make(
        None if any(values is None for values in column) else torch.from_numpy(np.stack(column)).to(device)
        for column in columns
    )


def _load(checkpoint: Path, device: Any) -> dict[str, Any]:  # noqa: ANN401
    try:
        state: dict[str, Any] = torch.load(checkpoint, map_location=device, weights_only=True)
    except Exception as error:  # torch raises whatever its unpickler meets
        raise ConfigError(f"{checkpoint}: no checkpoint of hid2 ({str(error).splitlines()[0]}); remove it") from error
    if not isinstance(state, dict) or set(state) != set(_STATE):
        raise ConfigError(f"{checkpoint}: no checkpoint of hid2; remove it")
    return state


def _save(checkpoint: Path, state: dict[str, Any]) -> None:
    with explained(checkpoint), beside(checkpoint) as hidden:
        torch.save(state, hidden)
