"""The DDQN update in minimal eager PyTorch."""

import time
from collections.abc import Callable
from itertools import pairwise

import torch
from ours import Case
from torch import nn


def make_torch_update(case: Case, rounds: int) -> Callable[[], float]:
    """A function that runs `rounds` times the updates of one episode and returns the seconds per update.

    It has the savings ours has: the mini-batches of one episode are drawn at once from ready tensors, and the target
    network, which does not change meanwhile, is evaluated once for all of them. Adam is the fused one, PyTorch's fastest.
    """
    torch.manual_seed(0)
    settings, sizes = case.settings, case.layer_sizes
    online, target = _network(sizes), _network(sizes)
    target.load_state_dict(online.state_dict())
    adam = torch.optim.Adam(online.parameters(), lr=settings.learning_rate, fused=True)
    capacity = settings.replay_capacity
    state, next_state = torch.rand(capacity, sizes[0]), torch.rand(capacity, sizes[0])
    action = torch.randint(sizes[-1], (capacity, 1))
    reward, going_on = torch.rand(capacity), (torch.rand(capacity) > 0.03).float()

    def one_episode() -> None:
        rows = torch.randint(capacity, (settings.updates_per_episode, settings.batch_size))
        with torch.no_grad():
            q_next_target = target(next_state[rows])
        batches = zip(state[rows], next_state[rows], action[rows], reward[rows], going_on[rows], q_next_target, strict=True)
        for s, s_next, a, r, on, q_next in batches:
            with torch.no_grad():
                best = online(s_next).argmax(-1, keepdim=True)
                wanted = r + case.task.discount * on * q_next.gather(-1, best).squeeze(-1)
            loss = (wanted - online(s).gather(-1, a).squeeze(-1)).square().mean()
            adam.zero_grad()
            loss.backward()
            adam.step()

    def seconds_per_update() -> float:
        began = time.perf_counter()
        for _ in range(rounds):
            one_episode()
        return (time.perf_counter() - began) / (rounds * settings.updates_per_episode)

    return seconds_per_update


def _network(sizes: tuple[int, ...]) -> nn.Sequential:
    layers: list[nn.Module] = []
    for a, b in pairwise(sizes):
        layers += [nn.Linear(a, b), nn.LeakyReLU()]
    return nn.Sequential(*layers[:-1])
