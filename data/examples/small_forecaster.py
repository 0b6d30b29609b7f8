"""A small forecaster to compare data sets with: VectorNet with six futures, some 190,000 parameters. Needs torch.

`hid2 forecast` and `hid2 paper prediction` run it from here; another forecaster needs nothing of it but files of av2's
submission format. Gao et al., "VectorNet: Encoding HD Maps and Agent Dynamics from Vectorized Representation", CVPR
2020: each polyline, an agent's history or a lane, goes through a small network and a maximum over its points; attention
between the polylines gives the target its surroundings. Instead of its one future, the head of Cui et al., "Multimodal
Trajectory Predictions for Autonomous Driving using Deep Convolutional Networks" (MTP), ICRA 2019: as many as wanted
with their probabilities; the mode that ends nearest learns the future, and the probabilities learn which that is.

On a CPU the same targets and seed give the same weights, interrupted or not. A GPU is used where there is one, and then
bits may differ.
"""

import os
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import torch
from scene_features import (  # beside this file
    AGENT_FEATURES,
    AGENT_KINDS,
    LANE_FEATURES,
    LANE_KINDS,
    ForecastTarget,
    TargetView,
    checksum,
)
from torch import nn

from bridge.files import beside, explained
from bridge.forecasting.predictions import FUTURE_STEPS, Forecast
from bridge.recordings.scenario import STEP_S
from netconvert.errors import ConfigError, ScenarioError

#: Width of the network (VectorNet has 64), layers and heads of attention, futures (av2's challenge has 6).
HIDDEN, LAYERS, HEADS, MODES = 64, 2, 4, 6
#: Targets of an update; AdamW's learning rate, falling to 0 as a cosine, and weight decay; updates to a checkpoint.
BATCH, LEARNING_RATE, WEIGHT_DECAY, CHECKPOINT_EVERY = 32, 1e-3, 1e-4, 100


class _Polylines(nn.Module):
    """Polylines (B, N, P, F) with their kinds (B, N, K) to (B, N, H): VectorNet's subgraph with two layers."""

    def __init__(self, features: int, kinds: int) -> None:
        super().__init__()
        self.first = nn.Sequential(nn.Linear(features + kinds, HIDDEN), nn.LayerNorm(HIDDEN), nn.ReLU())
        self.second = nn.Sequential(nn.Linear(2 * HIDDEN, HIDDEN), nn.LayerNorm(HIDDEN), nn.ReLU())

    def forward(self, points: torch.Tensor, kinds: torch.Tensor) -> torch.Tensor:
        """One vector for each polyline."""
        each = self.first(torch.cat([points, kinds.unsqueeze(2).expand(-1, -1, points.shape[2], -1)], dim=-1))
        return self.second(torch.cat([each, each.amax(dim=2, keepdim=True).expand_as(each)], dim=-1)).amax(dim=2)


class VectorNet(nn.Module):
    """Futures (B, K, 60, 2) in the target's frame, in UNIT_M, and their logits (B, K)."""

    def __init__(self) -> None:
        super().__init__()
        self.agents = _Polylines(AGENT_FEATURES + 1, AGENT_KINDS)
        self.lanes = _Polylines(LANE_FEATURES, LANE_KINDS)
        layer = nn.TransformerEncoderLayer(HIDDEN, HEADS, 2 * HIDDEN, dropout=0.0, batch_first=True, norm_first=True)
        self.between = nn.TransformerEncoder(layer, LAYERS, enable_nested_tensor=False)
        self.head = nn.Sequential(nn.Linear(2 * HIDDEN, 2 * HIDDEN), nn.ReLU())
        self.futures = nn.Linear(2 * HIDDEN, MODES * FUTURE_STEPS * 2)
        self.scores = nn.Linear(2 * HIDDEN, MODES)

    def forward(self, batch: TargetView) -> tuple[torch.Tensor, torch.Tensor]:
        """Futures and logits of a batch."""
        count, steps = batch.agents.shape[0], batch.agents.shape[2]
        time = torch.linspace(-1.0, 0.0, steps, device=batch.agents.device).view(1, 1, steps, 1)
        agents = torch.cat([batch.agents, time.expand(*batch.agents.shape[:3], 1)], dim=-1)
        each = self.agents(agents, batch.agent_kinds), self.lanes(batch.lanes, batch.lane_kinds)
        polylines = torch.cat(each, dim=1)
        absent = torch.cat([batch.agent_kinds.sum(-1) == 0, batch.lanes.abs().sum((-1, -2)) == 0], dim=1)
        around = self.between(polylines, src_key_padding_mask=absent)[:, 0]
        told = self.head(torch.cat([polylines[:, 0], around], dim=-1))
        # each mode is told as what it differs from going on at the observed velocity: the last step of the target
        velocity = batch.agents[:, 0, -1, 4:6]
        ahead = torch.arange(1, FUTURE_STEPS + 1, device=velocity.device).view(1, 1, -1, 1) * STEP_S
        straight = velocity.view(count, 1, 1, 2) * ahead
        return straight + self.futures(told).view(count, MODES, FUTURE_STEPS, 2), self.scores(told)


def _loss(futures: torch.Tensor, logits: torch.Tensor, truth: torch.Tensor) -> torch.Tensor:
    """The mode that ends nearest learns the future (smooth L1), the logits learn which it is (cross entropy)."""
    best = (futures[:, :, -1] - truth[:, None, -1]).norm(dim=-1).argmin(dim=1)
    nearest = futures[torch.arange(len(best), device=best.device), best]
    return nn.functional.smooth_l1_loss(nearest, truth) + 0.1 * nn.functional.cross_entropy(logits, best)


def train(
    targets: Sequence[ForecastTarget], checkpoint: Path, *, updates: int, seed: int, resume: bool = False,
    on_update: Callable[[int, int], None] | None = None,
) -> VectorNet:  # fmt: skip
    """Train on the targets that have a future; a checkpoint is left every CHECKPOINT_EVERY updates.

    resume: go on from the checkpoint, if there is one of the same training. Errors: ScenarioError where there is
    nothing to learn from, ConfigError for another training's checkpoint, ExportError.
    """
    data = [target for target in targets if target.seen.future is not None]
    if not data:
        raise ScenarioError("nothing to train on: no scored or focal track with 60 future steps in the training scenes")
    os.environ.setdefault("CUBLAS_WORKSPACE_CONFIG", ":4096:8")
    torch.set_num_threads(1)  # the same bits whatever the machine has
    torch.use_deterministic_algorithms(True, warn_only=True)  # torch's
    torch.manual_seed(seed)
    model = VectorNet().to(_device())
    optimiser = torch.optim.AdamW(model.parameters(), lr=LEARNING_RATE, weight_decay=WEIGHT_DECAY)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, updates)
    identity, parts = {"seed": seed, "updates": updates, "targets": checksum(data)}, (model, optimiser, schedule)
    done = 0
    if resume and checkpoint.is_file():
        try:
            of, states, done = torch.load(checkpoint, map_location=_device(), weights_only=True)
            differs = [name for name, value in identity.items() if of[name] != value]
            for part, state in zip(parts, states, strict=True):
                part.load_state_dict(state)
        except Exception as error:  # torch raises whatever its unpickler meets, or another network's sizes
            raise ConfigError(f"{checkpoint}: no checkpoint of hid2 ({error!r:.100}); remove it") from error
        if differs:
            raise ConfigError(f"{checkpoint}: of another training ({', '.join(differs)} differ); choose another folder")
    everything, per_epoch = _batch(data), -(-len(data) // BATCH)
    model.train()
    for update in range(done, updates):
        epoch, number = divmod(update, per_epoch)
        order = np.random.default_rng([seed, epoch]).permutation(len(data))
        rows = torch.from_numpy(order[number * BATCH : (number + 1) * BATCH]).to(_device())
        batch = TargetView._make(values[rows] for values in everything)
        loss = _loss(*model(batch), batch.future)
        if not torch.isfinite(loss):
            raise ScenarioError(f"update {update}: the loss is {float(loss)}, expected a finite number")
        optimiser.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(model.parameters(), 1.0)
        optimiser.step()
        schedule.step()
        if (update + 1) % CHECKPOINT_EVERY == 0 or update + 1 == updates:
            with explained(checkpoint), beside(checkpoint) as hidden:
                torch.save((identity, [part.state_dict() for part in parts], update + 1), hidden)
        if on_update is not None:
            on_update(update + 1, updates)
    return model


def forecast(model: VectorNet, targets: Sequence[ForecastTarget]) -> dict[str, Forecast]:
    """Forecasts of the focal tracks by scenario: probabilities (K,) and modes (K, 60, 2), m, in the city."""
    focal = [target for target in targets if target.focal]
    found: dict[str, Forecast] = {}
    model.eval()
    with torch.no_grad():
        for start in range(0, len(focal), BATCH):
            part = focal[start : start + BATCH]
            futures, logits = model(_batch(part))
            shares = torch.softmax(logits.double(), dim=1).cpu().numpy()
            for target, modes, share in zip(part, futures.cpu().numpy(), shares, strict=True):
                found[target.scenario_id] = share / share.sum(), {target.track_id: target.to_city(modes)}
    return found


def _device() -> torch.device:
    return torch.device("cuda" if torch.cuda.is_available() else "cpu")


def _batch(targets: Sequence[ForecastTarget]) -> TargetView:
    """The targets' arrays as tensors; None where one of them lacks it, as futures of forecasts may be."""
    columns = zip(*(target.seen for target in targets), strict=True)
    return TargetView._make(
        None if any(values is None for values in column) else torch.from_numpy(np.stack(column)).to(_device())
        for column in columns
    )
