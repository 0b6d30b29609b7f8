"""VectorNet with six futures: the small forecaster. Needs the extra `forecast`.

Gao et al., "VectorNet: Encoding HD Maps and Agent Dynamics from Vectorized Representation", CVPR 2020: each polyline,
an agent's history or a lane, goes through a small network and a maximum over its points; attention between the
polylines gives the target its surroundings. Instead of its one future, the head of Cui et al., "Multimodal Trajectory
Predictions for Autonomous Driving using Deep Convolutional Networks" (MTP), ICRA 2019: as many as wanted with their
probabilities; the mode that ends nearest learns the future, and the probabilities learn which that is.
"""

from typing import Any, NamedTuple

import torch
from torch import nn

from bridge.evaluation.predictions import FUTURE_STEPS
from bridge.forecasting.features import AGENT_FEATURES, AGENT_KINDS, LANE_FEATURES, LANE_KINDS
from bridge.recordings.scenario import STEP_S
from hid2.params import Forecasting


class Batch(NamedTuple):
    """Tensors of the arrays of `features.Target`, one row a target; future is None for forecasts."""

    agents: Any
    agent_kinds: Any
    lanes: Any
    lane_kinds: Any
    future: Any


class _Polylines(nn.Module):
    """Polylines (B, N, P, F) with their kinds (B, N, K) to (B, N, H): VectorNet's subgraph with two layers."""

    def __init__(self, features: int, kinds: int, hidden: int) -> None:
        super().__init__()
        self.first = nn.Sequential(nn.Linear(features + kinds, hidden), nn.LayerNorm(hidden), nn.ReLU())
        self.second = nn.Sequential(nn.Linear(2 * hidden, hidden), nn.LayerNorm(hidden), nn.ReLU())

    def forward(self, points: Any, kinds: Any) -> Any:  # noqa: ANN401
        """One vector for each polyline."""
        wide = torch.cat([points, kinds.unsqueeze(2).expand(-1, -1, points.shape[2], -1)], dim=-1)
        each = self.first(wide)
        whole = each.amax(dim=2, keepdim=True).expand_as(each)
        return self.second(torch.cat([each, whole], dim=-1)).amax(dim=2)


class VectorNet(nn.Module):
    """Futures (B, K, 60, 2) in the target's frame, in UNIT_M, and their logits (B, K)."""

    def __init__(self, params: Forecasting) -> None:
        super().__init__()
        self.modes = params.modes
        self.agents = _Polylines(AGENT_FEATURES + 1, AGENT_KINDS, params.hidden)
        self.lanes = _Polylines(LANE_FEATURES, LANE_KINDS, params.hidden)
        layer = nn.TransformerEncoderLayer(
            params.hidden, params.heads, 2 * params.hidden, dropout=0.0, batch_first=True, norm_first=True
        )
        self.between = nn.TransformerEncoder(layer, params.layers, enable_nested_tensor=False)
        self.head = nn.Sequential(nn.Linear(2 * params.hidden, 2 * params.hidden), nn.ReLU())
        self.futures = nn.Linear(2 * params.hidden, params.modes * FUTURE_STEPS * 2)
        self.scores = nn.Linear(2 * params.hidden, params.modes)

    def forward(self, batch: Batch) -> tuple[Any, Any]:
        """Futures and logits of a batch."""
        count, steps = batch.agents.shape[0], batch.agents.shape[2]
        time = torch.linspace(-1.0, 0.0, steps, device=batch.agents.device).view(1, 1, steps, 1)
        agents = torch.cat([batch.agents, time.expand(*batch.agents.shape[:3], 1)], dim=-1)
        polylines = torch.cat(
            [self.agents(agents, batch.agent_kinds), self.lanes(batch.lanes, batch.lane_kinds)], dim=1
        )
        absent = torch.cat([batch.agent_kinds.sum(-1) == 0, batch.lanes.abs().sum((-1, -2)) == 0], dim=1)
        around = self.between(polylines, src_key_padding_mask=absent)[:, 0]
        told = self.head(torch.cat([polylines[:, 0], around], dim=-1))
        # each mode is told as what it differs from going on at the observed velocity: the last step of the target
        velocity = batch.agents[:, 0, -1, 4:6]
        ahead = torch.arange(1, FUTURE_STEPS + 1, device=velocity.device).view(1, 1, -1, 1) * STEP_S
        straight = velocity.view(count, 1, 1, 2) * ahead
        return straight + self.futures(told).view(count, self.modes, FUTURE_STEPS, 2), self.scores(told)


def loss_of(futures: Any, logits: Any, truth: Any) -> Any:  # noqa: ANN401
    """The mode that ends nearest learns the future (smooth L1), the logits learn which it is (cross entropy)."""
    apart = (futures[:, :, -1] - truth[:, None, -1]).norm(dim=-1)
    best = apart.argmin(dim=1)
    nearest = futures[torch.arange(len(best), device=best.device), best]
    return nn.functional.smooth_l1_loss(nearest, truth) + 0.1 * nn.functional.cross_entropy(logits, best)
